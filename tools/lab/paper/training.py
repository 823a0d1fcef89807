"""All methods trained on all scenes, a process for each, and what the paper's tables say of them.

Table 1 of the paper (quality, size, time) and Table 2 (keyframes); its curves of quality over time.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from airgs_codec.errors import AirgsError
from airgs_codec.jobs.engines import Processes
from airgs_codec.progress import Progress
from airgs_codec.render.backend import CPU
from airgs_codec.scene.formats.ply import read_ply
from tools.lab import timed
from tools.lab.baselines.method import Frame, frame_path, mean_bytes, run_method
from tools.lab.paper.methods import make_method
from tools.lab.paper.scenes import Subject

RENDERED = 5  # frames whose pictures are timed
T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Trained:
    """A method on a scene; PSNR in dB and SSIM are means over the held-out views of a frame."""

    scene: str
    method: str
    frames: tuple[Frame, ...]
    fps: float  # pictures a second that one core draws of a held-out view, median over frames


@dataclass(frozen=True, slots=True)
class Job:
    subject: Subject
    method: str
    quick: bool
    folder: Path


def in_processes(work: Callable[[int, Any], T], calls: Iterable[Any], count: int, progress: Progress) -> list[T]:
    """What `work`, a function of a module, gives for each of `calls` and its number, each on one core, in their order.

    Raises the first error of a call.
    """
    numbered = list(enumerate(calls))
    done: dict[int, T] = {}
    for at, result in Processes(count, 1).map(_numbered, [(work, at, call) for at, call in numbered]):
        done[at] = result
        progress("runs", len(done), len(numbered))
    return [done[at] for at, _ in numbered]


def _numbered(work: Callable[[int, Any], T], at: int, call: Any) -> tuple[int, T]:
    return at, work(at, call)


def train(_: int, job: Job) -> Trained:
    footage = job.subject.footage(job.folder)
    try:
        frames = run_method(make_method(job.method, job.subject, job.quick), footage)
    except AirgsError as error:
        raise type(error)(f"{job.method} on {job.subject.name}: {error}") from error
    numbers = np.linspace(0, len(frames) - 1, min(RENDERED, len(frames))).astype(int)
    camera = footage.pictures.held_out(0)[0].camera
    seconds = []
    for number in numbers:
        loaded = CPU.load(read_ply(frame_path(job.folder, int(number))))
        seconds.append(timed(partial(loaded.draw, camera), 1)[0].cpu)
    return Trained(job.subject.name, job.method, tuple(frames), round(1 / float(np.median(seconds)), 1))


def row_of(trained: Trained, rate: float) -> dict[str, Any]:
    """Return what the tables say of a method, at a rate of frames a second.

    PSNR and deviations from their mean in dB; seconds of one core, those of a keyframe after the first frame with
    rejected fits in its group included, None where there is none.
    """
    frames = trained.frames
    quality = np.array([frame.psnr for frame in frames])
    away = np.abs(quality - quality.mean())
    keys = [frame.seconds for frame in frames[1:] if frame.kind == "key"]
    return {
        "scene": trained.scene, "method": trained.method, "psnr": float(quality.mean()),
        "worst": float(quality.min()), "deviation": float(away.mean()), "most_deviation": float(away.max()),
        "ssim": _mean([frame.ssim for frame in frames]), "kb_frame": mean_bytes(frames) / 1e3,
        "mbit_s": 8e-6 * mean_bytes(frames) * rate, "gaussians": _mean([frame.gaussians for frame in frames]),
        "train_s_frame": _mean([frame.seconds for frame in frames]), "key_s": _mean(keys) if keys else None,
        "fps": trained.fps,
    }  # fmt: skip


def _mean(values: Sequence[float]) -> float:
    return float(np.mean(values))
