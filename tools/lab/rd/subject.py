"""What all coders are measured on: the same rows, views and frames of one sequence; and what is made of points."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.interpolate import PchipInterpolator

from airgs_codec._sampling import evenly_spaced
from airgs_codec.analysis.grouping import plan_groups
from airgs_codec.media.image import read_picture, to_floats
from airgs_codec.media.metrics import mse, psnr
from airgs_codec.render import Camera, read_cameras, render
from airgs_codec.scene.beside import exact_number
from airgs_codec.scene.gaussians import Gaussians, morton_order
from airgs_codec.scene.sequence import GaussianSequence, open_sequence
from tools.lab import required, setting


@dataclass(frozen=True, slots=True)
class RdPoint:
    coder: str
    setting: str
    kb_per_frame: float
    psnr: float  # dB, against renderings of the input
    truth_psnr: float | None  # dB, against pictures taken of the scene
    encode_s: float
    decode_s: float


def curves(points: Sequence[RdPoint]) -> dict[str, list[RdPoint]]:
    """The points of each coder in order of rate; coders in order of their first point."""
    names = dict.fromkeys(p.coder for p in points)
    return {name: sorted((p for p in points if p.coder == name), key=lambda p: p.kb_per_frame) for name in names}


def bd_rate(ours: Sequence[RdPoint], theirs: Sequence[RdPoint], low: float = 0.0, high: float = 99.0) -> float | None:
    """Bjontegaard's mean difference of log rate over the PSNR in [low, high] that both curves cover, as a share.

    Log rate is interpolated over PSNR by monotone cubics, never beyond a curve's ends. Points that another of the same
    curve beats at fewer bytes are left out: a rate curve must rise. None under 4 points, or where nothing is common.
    """
    best = [rising(points) for points in (ours, theirs)]
    if min(len(c) for c in best) < 4:
        return None
    low = max(low, *(c[0].psnr for c in best))
    high = min(high, *(c[-1].psnr for c in best))
    if high <= low:
        return None
    means = []
    for curve in best:
        fit = PchipInterpolator([p.psnr for p in curve], [np.log(p.kb_per_frame) for p in curve])
        means.append(float(fit.integrate(low, high)) / (high - low))
    return float(np.expm1(means[0] - means[1]))


def kb_at(curve: Sequence[RdPoint], psnr: float) -> float | None:
    """kB a frame at which a curve reaches a PSNR in dB, log rate on straight lines over PSNR; None beyond its ends."""
    best = rising(curve)
    if len(best) < 2 or not best[0].psnr <= psnr <= best[-1].psnr:
        return None
    return float(np.exp(np.interp(psnr, [p.psnr for p in best], [np.log(p.kb_per_frame) for p in best])))


def rising(points: Sequence[RdPoint]) -> list[RdPoint]:
    kept: list[RdPoint] = []
    for point in sorted(points, key=lambda p: p.kb_per_frame):
        if not kept or point.psnr > kept[-1].psnr:
            kept.append(point)
    return kept


Pictures = dict[int, list[np.ndarray]]  # frame -> (H, W, 3) of each camera, 0..1


@dataclass(frozen=True, slots=True)
class Measured:
    sequence: Path = required("a sequence")
    views: Path = required("its cameras, of which the held-out ones measure, or all if none is held out")
    fps: str = setting("", "frames a second, where the sequence does not say")

    def open(self) -> tuple[GaussianSequence, list[Camera]]:
        """The sequence, and the cameras that measure. Raises AirgsError."""
        fps, cameras = exact_number(self.fps) if self.fps else None, read_cameras(self.views)
        return open_sequence(self.sequence, views=self.views, fps=fps), [c for c in cameras if c.held_out] or cameras


@dataclass(frozen=True, slots=True, eq=False)
class Coded:
    """What a coder made of a sequence: bytes of everything fetched, and at least the measured frames, decoded."""

    bytes_per_frame: float
    frames: dict[int, Gaussians]
    encode_s: float
    decode_s: float


@dataclass(frozen=True, slots=True, eq=False)
class Subject:
    """The sequence, its repaired groups in Morton order, and what is measured on."""

    sequence: GaussianSequence
    groups: list[tuple[int, list[Gaussians]]]  # first frame, frames
    cameras: list[Camera]
    measured: list[int]  # frames
    references: Pictures
    truth: Pictures  # empty: no pictures were taken

    def frame(self, number: int) -> Gaussians:
        return next(frames[number - start] for start, frames in self.groups if start <= number < start + len(frames))

    def point(self, trial: Trial) -> RdPoint:
        coded = trial.code(self)
        shown = {n: [render(coded.frames[n], camera).rgb for camera in self.cameras] for n in self.measured}
        true = pooled_psnr(shown, self.truth) if self.truth else None
        figures = coded.bytes_per_frame / 1e3, pooled_psnr(shown, self.references), true
        return RdPoint(trial.coder, trial.setting, *figures, coded.encode_s, coded.decode_s)


@dataclass(frozen=True, slots=True)
class Trial:
    """A coder at a setting. `code` may raise AirgsError where the setting cannot be met."""

    coder: str
    setting: str
    code: Callable[[Subject], Coded]


def open_subject(sequence: GaussianSequence, cameras: list[Camera], count: int, views: Path) -> Subject:
    """Read everything once; `count` frames are measured, first and last among them."""
    groups = []
    for start, stop in plan_groups(sequence).spans:
        frames = sequence.load(range(start, stop)).frames
        order = morton_order(frames[len(frames) // 2].means)
        groups.append((start, [frame.take(order) for frame in frames]))
    measured = evenly_spaced(len(sequence), count)
    truth = read_truth(views, cameras, measured)
    subject = Subject(sequence, groups, cameras, measured, {}, truth)
    subject.references.update({n: [render(subject.frame(n), c).rgb for c in cameras] for n in measured})
    return subject


def pooled_psnr(shown: Pictures, wanted: Pictures) -> float:
    """PSNR in dB of the squared error pooled over frames and cameras."""
    pairs = [zip(pictures, wanted[number], strict=True) for number, pictures in shown.items()]
    return psnr(float(np.mean([mse(a, b) for pair in pairs for a, b in pair])))


def read_truth(views: Path, cameras: Sequence[Camera], frames: Sequence[int]) -> Pictures:
    """Pictures of each frame seen by each camera; empty unless transforms.json names all of them.

    Raises SceneError for a file that is no picture.
    """
    entries = json.loads(views.read_text(encoding="utf-8"))["frames"]
    paths = {(e.get("camera"), e.get("time_index")): views.parent / e.get("file_path", "") for e in entries}
    wanted = {number: [paths.get((camera.name, number)) for camera in cameras] for number in frames}
    if not all(path and path.is_file() for row in wanted.values() for path in row):
        return {}
    return {number: [to_floats(read_picture(path)[..., :3]) for path in row if path] for number, row in wanted.items()}
