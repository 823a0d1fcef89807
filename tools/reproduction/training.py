"""All methods trained on all scenes, a process for each, and what the paper's tables say of them.

Table 1 of the paper (quality, size, time) and Table 2 (keyframes); its curves of quality over time.
"""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from airgs_codec.errors import AirgsError
from airgs_codec.jobs.engines import prepare_worker
from airgs_codec.progress import Progress
from airgs_codec.render.backend import CPU
from airgs_codec.scene.ply import read_ply
from tools.baselines.method import Frame, frame_path, mean_bytes, run_method
from tools.reproduction.methods import make_method
from tools.reproduction.scenes import Subject

RENDERED = 5  # frames whose pictures are timed


@dataclass(frozen=True, slots=True)
class Trained:
    """A method on a scene; PSNR in dB and SSIM are means over the held-out views of a frame."""

    scene: str
    method: str
    frames: tuple[Frame, ...]
    fps: float  # pictures a second that one core draws of a held-out view, median over frames


@dataclass(frozen=True, slots=True)
class Row:
    """A row of the paper's Table 1 and Table 2."""

    scene: str
    method: str
    psnr: float  # dB, mean over frames
    worst: float  # dB, the worst frame
    deviation: float  # dB, mean over frames of the distance to the mean
    most_deviation: float  # dB, the largest of these
    ssim: float
    kb_frame: float
    gaussians: float  # mean over frames
    train_s_frame: float  # seconds of one core
    key_s: float | None  # the same of a keyframe after the first frame, rejected fits in its group included; None: none
    fps: float


@dataclass(frozen=True, slots=True)
class Job:
    """A method that is trained on a scene, into a folder."""

    subject: Subject
    method: str
    quick: bool
    folder: Path


def train_all(jobs: Sequence[Job], processes: int, progress: Progress) -> list[Trained]:
    """All jobs, in their order. Raises the first error of a job, after those that run have ended."""
    done: dict[int, Trained] = {}
    with ProcessPoolExecutor(
        processes, get_context("spawn"), prepare_worker, (os.getpid(), 1)
    ) as pool:  # one core each
        tasks = {pool.submit(_train, job): i for i, job in enumerate(jobs)}
        for task in as_completed(tasks):
            done[tasks[task]] = task.result()
            progress("methods trained", len(done), len(jobs))
    return [done[i] for i in range(len(jobs))]


def _train(job: Job) -> Trained:
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
        loaded.draw(camera)  # compiles
        begun = time.perf_counter()
        loaded.draw(camera)
        seconds.append(time.perf_counter() - begun)
    return Trained(job.subject.name, job.method, tuple(frames), round(1 / float(np.median(seconds)), 1))


def row_of(trained: Trained) -> Row:
    """What the tables say of a method."""
    frames = trained.frames
    quality = np.array([frame.psnr for frame in frames])
    away = np.abs(quality - quality.mean())
    keys = [frame.seconds for frame in frames[1:] if frame.kind == "key"]
    return Row(
        scene=trained.scene,
        method=trained.method,
        psnr=float(quality.mean()),
        worst=float(quality.min()),
        deviation=float(away.mean()),
        most_deviation=float(away.max()),
        ssim=float(np.mean([frame.ssim for frame in frames])),
        kb_frame=mean_bytes(frames) / 1e3,
        gaussians=float(np.mean([frame.gaussians for frame in frames])),
        train_s_frame=float(np.mean([frame.seconds for frame in frames])),
        key_s=float(np.mean(keys)) if keys else None,
        fps=trained.fps,
    )


def as_table(rows: Sequence[Row]) -> list[dict[str, object]]:
    """The rows for CSV and JSON, figures rounded to what they are good for."""
    return [{n: round(v, 4) if isinstance(v, float) else v for n, v in asdict(row).items()} for row in rows]
