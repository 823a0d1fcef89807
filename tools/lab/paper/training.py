"""Which scenes and methods are compared, all methods trained on all scenes, and one setting changed at a time.

A scene is NAME=FOLDER, then options after commas. Tables 1 and 2 of the paper: quality, size, time, keyframes.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
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
from airgs_codec.render.backend import CPU
from airgs_codec.scene.formats.ply import read_ply
from airgs_codec.trainer.data.multiview import MultiviewScene, with_held_out, with_near
from airgs_codec.trainer.data.pictures import ScenePictures
from airgs_codec.trainer.data.readers import open_scene
from airgs_codec.trainer.settings import TrainSettings, preset
from tools.lab import timed
from tools.lab.baselines.airgs import AirGS
from tools.lab.baselines.fourdgs import Fourdgs
from tools.lab.baselines.method import Footage, Frame, Method, frame_path, mean_bytes, run_method
from tools.lab.baselines.stream3dgs import Stream3dgs, StreamSettings
from tools.lab.baselines.threedgs import Naive3dgs
from tools.lab.baselines.v3 import V3, V3Settings

OPTIONS = ("frames", "size", "near", "held")
QUICK_FRAMES, QUICK_SIZE = 4, 128  # most of a scene in a quick run


@dataclass(frozen=True, slots=True)
class Subject:
    name: str
    folder: Path
    frames: tuple[int, int | None] = (0, None)  # [start, stop)
    size: int | None = None  # longest side of the pictures in pixels; None: as they are
    near: float | None = None  # near plane in world units; None: as the scene has it
    held: tuple[str, ...] = ()  # cameras that are held out; none: those that the scene says

    def quick(self) -> Subject:
        start, stop = self.frames
        last = start + QUICK_FRAMES if stop is None else min(stop, start + QUICK_FRAMES)
        return replace(self, frames=(start, last), size=min(self.size or QUICK_SIZE, QUICK_SIZE))

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


QUICK_FIRST = 300  # iterations of a fit from scratch in a quick run


def trainer_settings(subject: Subject, quick: bool) -> TrainSettings:
    """The default settings of the trainer, at the size of the pictures of a scene."""
    settings = TrainSettings(max_size=subject.size)
    if not quick:
        return settings
    return replace(settings, first_iterations=QUICK_FIRST, keyframe_iterations=150, frame_iterations=60, budget=2_000)


def _airgs(subject: Subject, quick: bool) -> Method:
    return AirGS(subject.open(), trainer_settings(subject, quick))


def _paper(subject: Subject, quick: bool) -> Method:
    training = preset("paper", trainer_settings(subject, quick))
    return AirGS(subject.open(), training, as_in_paper(EncodeSettings()), name="airgs-paper")


def _v3(_: Subject, quick: bool) -> Method:
    short = V3Settings(rows=2_000, keyframe_iterations=QUICK_FIRST, finetune_iterations=60, frame_iterations=40)
    return V3(short if quick else V3Settings())


def _stream(subject: Subject, quick: bool) -> Method:
    first = trainer_settings(subject, quick)
    return Stream3dgs(StreamSettings(first, iterations=40, added_iterations=20) if quick else StreamSettings(first))


def _fourdgs(_: Subject, quick: bool) -> Method:
    return Fourdgs(iterations=2 * QUICK_FIRST) if quick else Fourdgs()


def _naive(_: Subject, quick: bool) -> Method:
    return Naive3dgs(iterations=QUICK_FIRST) if quick else Naive3dgs()


METHODS: dict[str, Callable[[Subject, bool], Method]] = {
    "airgs": _airgs, "airgs-paper": _paper, "v3": _v3, "3dgstream": _stream, "4dgs": _fourdgs, "naive3dgs": _naive,
}  # fmt: skip


RENDERED = 5  # frames whose pictures are timed
T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Trained:
    """A method on a scene; PSNR in dB and SSIM are means over the held-out views of a frame."""

    scene: str
    method: str
    frames: tuple[Frame, ...]
    fps: float  # pictures a second that one core draws of a held-out view, median over frames


def in_processes(work: Callable[..., T], calls: Sequence[Any], count: int, progress: Progress) -> list[T]:
    """What `work`, a function of a module, gives for each of `calls`, each on one core, in their order.

    Raises the first error of a call.
    """
    with ProcessPoolExecutor(count, get_context("spawn"), prepare_worker, (os.getpid(), 1)) as executor:
        return Work(executor, progress=progress).results("runs", work, calls)


def train(subject: Subject, method: str, quick: bool, folder: Path) -> Trained:
    footage = subject.footage(folder)
    try:
        frames = run_method(METHODS[method](subject, quick), footage)
    except AirgsError as error:
        raise type(error)(f"{method} on {subject.name}: {error}") from error
    numbers = np.linspace(0, len(frames) - 1, min(RENDERED, len(frames))).astype(int)
    camera = footage.pictures.held_out(0)[0].camera
    seconds = []
    for number in numbers:
        loaded = CPU.load(read_ply(frame_path(folder, int(number))))
        seconds.append(timed(partial(loaded.draw, camera), 1)[0].cpu)
    return Trained(subject.name, method, tuple(frames), round(1 / float(np.median(seconds)), 1))


def row_of(trained: Trained, rate: float) -> dict[str, Any]:
    """Return what the tables say of a method, at a rate of frames a second.

    PSNR and deviations from their mean in dB; seconds of one core, those of a keyframe after the first frame with
    rejected fits in its group included, None where there is none.
    """
    frames = trained.frames
    quality = np.array([frame.psnr for frame in frames])
    away = np.abs(quality - quality.mean())
    keyframes = [frame.seconds for frame in frames[1:] if frame.kind == "keyframe"]
    return {
        "scene": trained.scene, "method": trained.method, "psnr": float(quality.mean()),
        "worst": float(quality.min()), "deviation": float(away.mean()), "most_deviation": float(away.max()),
        "ssim": _mean([frame.ssim for frame in frames]), "kb_frame": mean_bytes(frames) / 1e3,
        "mbit_s": 8e-6 * mean_bytes(frames) * rate, "gaussians": _mean([frame.gaussians for frame in frames]),
        "train_s_frame": _mean([frame.seconds for frame in frames]),
        "keyframe_s": _mean(keyframes) if keyframes else None,
        "fps": trained.fps,
    }  # fmt: skip


def _mean(values: Sequence[float]) -> float:
    return float(np.mean(values))
