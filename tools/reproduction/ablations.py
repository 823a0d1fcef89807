"""One setting of the trainer changed at a time, on a few frames of a scene around a keyframe."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from airgs_codec.errors import TrainingError
from airgs_codec.train.settings import TrainSettings
from tools.baselines.airgs import AirGS
from tools.baselines.method import mean_bytes, run_method
from tools.reproduction.scenes import Subject

SIZE = 160  # longest side of the pictures in pixels
TAU = 4.0  # dB under the quality of the first frame: where τ lies in "strict"


@dataclass(frozen=True, slots=True)
class Change:
    """A setting that is not as usual."""

    question: str
    name: str
    settings: TrainSettings


@dataclass(frozen=True, slots=True)
class Outcome:
    """What became of a change; PSNR in dB over held-out views."""

    question: str
    name: str
    psnr: float
    worst: float
    kb_frame: float
    keys: int
    gaussians: int  # in the last frame
    train_s_frame: float
    note: str = ""


def changes(base: TrainSettings) -> list[Change]:
    """All of them; the first one is the trainer as it is."""

    def change(question: str, name: str, **some: object) -> Change:
        return Change(question, name, replace(base, **some))  # type: ignore[arg-type]

    weight = base.temporal.weight
    temporal = "temporal loss λ_t"
    return [
        change("default", "as it is"),
        change("grouping τ", "no keyframe after the first", min_psnr_db=0.0, max_drop_db=math.inf),
        change("grouping τ", "τ = 30 dB alone, the paper's", max_drop_db=math.inf),
        change("grouping τ", f"a drop of {TAU / 4:g} dB", max_drop_db=TAU / 4),
        change("how frames move", "six MLPs", deltas="mlp"),
        change("how frames move", "MLPs, then each on its own", deltas="mlp+residual"),
        change(temporal, "0", temporal=replace(base.temporal, weight=0.0)),
        change(temporal, "a tenth", temporal=replace(base.temporal, weight=weight / 10)),
        change(temporal, "ten times", temporal=replace(base.temporal, weight=10 * weight)),
        change("inflation loss λ_inf", "0", inflation=0.0),
        change("inflation loss λ_inf", "100 times", inflation=100 * base.inflation),
        change("new Gaussians at keyframes", "none", max_growth=0.0),
        change("new Gaussians at keyframes", "without seeds", seeds=False),
        change("what rests", "not known", static="off"),
    ]


def shortened(settings: TrainSettings) -> TrainSettings:
    """Half of the usual iterations or fewer: what matters is the difference that a change makes."""
    return replace(settings, first_iterations=1000, key_iterations=500, frame_iterations=150)


def ablate(subject: Subject, base: TrainSettings, folder: Path, name: str) -> Outcome:
    """The change of a name, trained and encoded; a run that fails says so in its note."""
    change = next(c for c in changes(base) if f"{c.question}: {c.name}" == name)
    method = AirGS(subject.open(), change.settings)
    footage = subject.footage(folder)
    try:
        frames = run_method(method, footage)
    except TrainingError as error:
        nan = math.nan
        return Outcome(change.question, change.name, nan, nan, nan, 0, 0, nan, str(error))
    quality = [frame.psnr for frame in frames]
    return Outcome(
        question=change.question,
        name=change.name,
        psnr=sum(quality) / len(quality),
        worst=min(quality),
        kb_frame=mean_bytes(frames) / 1e3,
        keys=sum(frame.kind == "key" for frame in frames),
        gaussians=frames[-1].gaussians,
        train_s_frame=sum(frame.seconds for frame in frames) / len(frames),
    )


def names(base: TrainSettings) -> Sequence[str]:
    """The names of all changes."""
    return [f"{c.question}: {c.name}" for c in changes(base)]
