"""One setting of the trainer changed at a time, on a few frames of a scene around a keyframe."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from airgs_codec.errors import TrainingError
from airgs_codec.trainer.settings import TrainSettings
from tools.lab.baselines.airgs import AirGS
from tools.lab.baselines.method import mean_bytes, run_method
from tools.lab.paper.scenes import Subject

SIZE = 160  # longest side of the pictures in pixels
AS_IT_IS = "as it is"


@dataclass(frozen=True, slots=True)
class Change:
    question: str
    name: str
    settings: TrainSettings


@dataclass(frozen=True, slots=True)
class Ablation:
    subject: Subject
    change: Change
    folder: Path


def changes(base: TrainSettings) -> list[Change]:
    """All of them; the first one is the trainer as it is."""

    def change(question: str, name: str, **some: object) -> Change:
        return Change(question, name, replace(base, **some))  # type: ignore[arg-type]

    weight = base.temporal.weight
    temporal = "temporal loss λ_t"
    return [
        change("", AS_IT_IS),
        change("grouping τ", "no keyframe after the first", min_psnr_db=0.0, max_drop_db=math.inf),
        change("grouping τ", "τ = 30 dB alone, the paper's", max_drop_db=math.inf),
        change("grouping τ", "a drop of 1 dB", max_drop_db=1.0),
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


def ablate(number: int, ablation: Ablation) -> dict[str, Any]:
    """The change trained and encoded, going on where a run before was interrupted; one that fails says so in its note.

    PSNR in dB over held-out views, Gaussians in the last frame.
    """
    change = ablation.change
    row: dict[str, Any] = {"question": change.question, "name": change.name}
    footage = ablation.subject.footage(ablation.folder / f"{number:02d}")
    try:
        frames = run_method(AirGS(ablation.subject.open(), change.settings), footage)
    except TrainingError as error:
        return row | {"psnr": math.nan, "kb_frame": math.nan, "note": str(error)}
    quality = [frame.psnr for frame in frames]
    return row | {
        "psnr": sum(quality) / len(quality),
        "worst": min(quality),
        "kb_frame": mean_bytes(frames) / 1e3,
        "keys": sum(frame.kind == "key" for frame in frames),
        "gaussians": frames[-1].gaussians,
        "train_s_frame": sum(frame.seconds for frame in frames) / len(frames),
    }
