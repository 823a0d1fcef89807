"""Which scenes and methods are compared, all methods trained on all scenes, and one setting changed at a time.

A scene is NAME=FOLDER, then options after commas. Tables 1 and 2 of the paper: quality, size, time, keyframes.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, fields, replace
from functools import partial
from itertools import pairwise
from multiprocessing import get_context
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from airgs_codec.cli.options import parse_frames
from airgs_codec.encoder.settings import EncodeSettings, as_in_paper
from airgs_codec.errors import AirgsError, ConfigError
from airgs_codec.jobs.executors import prepare_worker
from airgs_codec.jobs.work import Work
from airgs_codec.progress import Progress
from airgs_codec.trainer.data.multiview import MultiviewScene, with_held_out, with_near
from airgs_codec.trainer.data.pictures import ScenePictures
from airgs_codec.trainer.data.readers import open_scene
from airgs_codec.trainer.settings import FIRST, Temporal, TrainSettings, preset
from tools.lab.baselines.airgs import AirGS
from tools.lab.baselines.fourdgs import Fourdgs
from tools.lab.baselines.method import Footage, Frame, Method, mean_bytes, run_method
from tools.lab.baselines.stream3dgs import Stream3dgs, StreamSettings
from tools.lab.baselines.threedgs import Naive3dgs
from tools.lab.baselines.v3 import V3, V3Settings

OPTIONS = ("frames", "size", "near", "held")
T = TypeVar("T", bound=Any)


@dataclass(frozen=True, slots=True)
class Subject:
    name: str
    folder: Path
    frames: tuple[int, int | None] = (0, None)  # [start, stop)
    size: int | None = None  # longest side of the pictures in pixels; None: as they are
    near: float | None = None  # near plane in world units; None: as the scene has it
    held: tuple[str, ...] = ()  # cameras that are held out; none: those that the scene says

    def words(self) -> dict[str, object]:
        words = {"scene": self.folder.resolve().name, "frames": self.frames, "size": self.size, "near": self.near}
        return words | ({"held": self.held} if self.held else {})

    def open(self) -> MultiviewScene:
        """The scene, some of its cameras held out. Raises SceneError."""
        scene = with_held_out(open_scene(self.folder, frames=self.frames), self.held or None)
        return scene if self.near is None else with_near(scene, self.near)

    def footage(self, folder: Path) -> Footage:
        """Return what a method is trained on, into a folder. Raises SceneError."""
        scene = self.open()
        return Footage(
            ScenePictures(scene, TrainSettings(max_size=self.size)), len(scene), scene.points, folder, self.words()
        )


def parse_subject(text: str) -> Subject:
    """NAME=FOLDER[,frames=A:B][,size=PX][,near=Z][,held=CAMERA+CAMERA...]. Raises ConfigError."""
    first, *rest = text.split(",")
    name, _, folder = first.partition("=")
    options = dict(part.partition("=")[::2] for part in rest)
    if not name or not folder or set(options) - set(OPTIONS):
        raise ConfigError(f"--scene: expected NAME=FOLDER with {', '.join(OPTIONS)} after commas, got {text!r}")
    try:
        size = int(options["size"]) if "size" in options else None
        near = float(options["near"]) if "near" in options else None
    except ValueError as error:
        raise ConfigError(f"--scene {text!r}: {error}") from error
    held = tuple(filter(None, options.get("held", "").split("+")))
    return Subject(name, Path(folder), parse_frames(options.get("frames")), size, near, held)


@dataclass(frozen=True, slots=True)
class Means:
    """What all methods have alike."""

    rows: int  # most Gaussians that a viewer has of a frame
    share: float  # of the iterations that each method would have

    def less(self, settings: T) -> T:
        """The settings with that share of their iterations."""
        counts = {f.name: getattr(settings, f.name) for f in fields(settings) if f.name.endswith("iterations")}
        fewer = {name: max(1, round(self.share * (count or FIRST))) for name, count in counts.items()}
        return replace(settings, **fewer)

    def training(self, subject: Subject) -> TrainSettings:
        """The trainer's defaults; a third of the Gaussians is left for what appears later."""
        settings = TrainSettings(max_size=subject.size, budget=round(self.rows / 1.5), capacity=self.rows)
        return self.less(settings)


def _v3(_: Subject, means: Means) -> Method:
    return V3(means.less(V3Settings(rows=means.rows)))


def _stream(subject: Subject, means: Means) -> Method:
    first = means.training(subject)
    return Stream3dgs(means.less(StreamSettings(first, most_added=means.rows - (first.budget or 0))))


PAPER, SUMMED, SEEDED = "airgs-paper", "paper, sum", "paper, seeded"
ABLATIONS: dict[str, tuple[str, dict[str, Any]]] = {  # our trainer: a preset, and what differs from it
    "airgs": ("default", {}),
    "airgs, tau alone": ("default", {"min_psnr_db": 30.0, "max_drop_db": math.inf}),
    PAPER: ("paper", {}),
    SUMMED: ("paper", {"temporal": Temporal(1e-3, "sum", 1.0)}),
    "paper, mean of elements": ("paper", {"temporal": Temporal(1e-3, "elements", 1.0)}),
    "paper, no keyframes": ("paper", {"min_psnr_db": 0.0}),
    "paper, no inflation loss": ("paper", {"inflation": 0.0}),
    SEEDED: ("paper", {"seeds": True}),
}


def ours(name: str, subject: Subject, means: Means) -> AirGS:
    """Our trainer by a name of ABLATIONS, with the encoder's preset of the same name."""
    base, changes = ABLATIONS[name]
    usual = means.training(subject)
    training = replace(preset(base, usual), capacity=usual.capacity, **changes)
    encoding = EncodeSettings() if base == "default" else as_in_paper(EncodeSettings())
    return AirGS(subject.open(), training, encoding, name)


METHODS: dict[str, Callable[[Subject, Means], Method]] = {
    **{name: partial(ours, name) for name in ABLATIONS}, "v3": _v3, "3dgstream": _stream,
    "4dgs": lambda _, means: means.less(Fourdgs(rows=means.rows)),
    "naive3dgs": lambda _, means: means.less(Naive3dgs(rows=means.rows)),
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Trained:
    """A method on a scene; PSNR in dB and SSIM are means over the held-out views of a frame."""

    scene: str
    method: str
    frames: tuple[Frame, ...]


def in_processes(work: Callable[..., T], calls: Sequence[Any], count: int, progress: Progress) -> list[T]:
    """What `work`, a function of a module, gives for each of `calls`, each on one core, in their order.

    Raises the first error of a call.
    """
    with ProcessPoolExecutor(count, get_context("spawn"), prepare_worker, (os.getpid(), 1)) as executor:
        return Work(executor, progress=progress).results("runs", work, calls)


def train(subject: Subject, method: str, means: Means, folder: Path) -> Trained:
    footage = subject.footage(folder)
    try:
        frames = run_method(METHODS[method](subject, means), footage)
    except AirgsError as error:
        raise type(error)(f"{method} on {subject.name}: {error}") from error
    return Trained(subject.name, method, tuple(frames))


def row_of(trained: Trained) -> dict[str, Any]:
    """Return what the tables say of a method.

    PSNR and deviations from their mean in dB, `fall`: how far any frame is below the first one of its group. Seconds
    are those of CPU time, training and coding, those of encodes included.
    """
    frames = trained.frames
    quality = np.array([frame.psnr for frame in frames])
    away = np.abs(quality - quality.mean())
    starts = [t for t, frame in enumerate(frames) if frame.kind == "keyframe"]
    falls = [float(quality[a] - quality[a:b].min()) for a, b in pairwise([*starts, len(frames)])]
    return {
        "scene": trained.scene, "method": trained.method, "psnr": float(quality.mean()),
        "lowest": float(quality.min()), "fall": max(falls), "groups": len(starts),
        "deviation": float(away.mean()), "most_deviation": float(away.max()),
        "ssim": _mean([frame.ssim for frame in frames]), "kb_frame": mean_bytes(frames) / 1e3,
        "gaussians": max(frame.gaussians for frame in frames),
        "train_s_frame": _mean([frame.seconds for frame in frames]),
    }  # fmt: skip


def _mean(values: Sequence[float]) -> float:
    return float(np.mean(values))
