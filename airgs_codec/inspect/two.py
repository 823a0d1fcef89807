"""Two scenes or packages seen by the same cameras: PSNR, SSIM and CIEDE2000, the worst picture and a typical one.

The first, A, is the reference: what it shows is what B should show.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from airgs_codec.encoder.quality import QualitySums
from airgs_codec.inspect.sides import Side
from airgs_codec.media.metrics import Reference, psnr
from airgs_codec.package.manifest import Quality
from airgs_codec.progress import Progress, silent
from airgs_codec.render import Camera, render


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """One picture: a frame as one camera sees it."""

    frame: int
    camera: Camera
    psnr: float  # dB, of B against A

    def __str__(self) -> str:
        return f"{self.psnr:.2f} dB, frame {self.frame}, camera {self.camera.name}"

    def to_json(self) -> dict[str, Any]:
        """The same as plain values, the camera by its name and position."""
        place = self.camera.position.tolist()
        return {"frame": self.frame, "camera": self.camera.name, "position": place, "psnr": self.psnr}


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """How near B is to A over all pictures of some frames."""

    frames: tuple[int, ...]
    cameras: tuple[str, ...]  # their names
    gaussians: tuple[tuple[int, int], tuple[int, int]]  # of A and of B: fewest and most rows of a frame
    quality: Quality
    worst: Seen
    typical: Seen  # the picture whose error is the median


def compare_two(a: Side, b: Side, frames: range, cameras: Sequence[Camera], progress: Progress = silent) -> Comparison:
    """B against A in the same frames and views, at least one of each.

    PSNR is of the mean squared error over all pictures (`media.metrics.PSNR_CAP` where there is none), SSIM and
    CIEDE2000 are means. Raises SceneError or FormatError for a frame that cannot be read.
    """
    sums = QualitySums()
    rows: list[tuple[int, int]] = []
    for done, (original, other) in enumerate(zip(a.read(frames), b.read(frames), strict=True)):
        progress("comparing", done, len(frames))
        rows.append((len(original), len(other)))
        for camera in cameras:
            sums.add(render(other, camera).rgb, Reference.of(render(original, camera).rgb))
    order = np.argsort(sums.squared, kind="stable")

    def seen(place: int) -> Seen:
        return Seen(frames[place // len(cameras)], cameras[place % len(cameras)], psnr(sums.squared[place]))

    first, second = zip(*rows, strict=True)
    return Comparison(
        frames=tuple(frames),
        cameras=tuple(camera.name for camera in cameras),
        gaussians=((min(first), max(first)), (min(second), max(second))),
        quality=sums.quality(),
        worst=seen(int(order[-1])),
        typical=seen(int(order[len(order) // 2])),
    )


def comparison_json(a: Side, b: Side, result: Comparison) -> dict[str, Any]:
    """The figures of both sides and of their comparison as plain values."""
    return {
        "reference": _side(a, result.gaussians[0]),
        "compared": _side(b, result.gaussians[1]),
        "frames": list(result.frames),
        "cameras": list(result.cameras),
        "quality": dataclasses.asdict(result.quality),
        "worst": result.worst.to_json(),
        "typical": result.typical.to_json(),
    }


def _side(side: Side, gaussians: tuple[int, int]) -> dict[str, Any]:
    claimed = dataclasses.asdict(side.claimed) if side.claimed else None
    return {
        "name": side.name,
        "rung": side.rung,
        "frames": side.frames,
        "fps": side.fps and float(side.fps),
        "sh_degree": side.sh_degree,
        "gaussians": list(gaussians),
        "bytes_per_frame": side.bytes_per_frame,
        "claimed": claimed,
    }


def format_two(a: Side, b: Side, result: Comparison, views: str, notes: Iterable[str] = ()) -> str:
    """The same for people; `views` says what the cameras are, `notes` what was left out."""
    q, frames = result.quality, result.frames
    return "\n".join(
        [
            f"A, the reference: {_words(a, result.gaussians[0])}",
            f"B: {_words(b, result.gaussians[1])}, {b.bytes_per_frame / a.bytes_per_frame:.3g} times those of A",
            f"{len(frames)} frame{'s' * (len(frames) > 1)} ({frames[0]} to {frames[-1]}) in {views}",
            *(f"left out: {note}" for note in notes),
            f"PSNR    {_decibels(q)} pooled over pictures{_claim(b)}",
            f"SSIM    {q.ssim:.4f}",
            f"ΔE2000  {q.delta_e:.2f}",
            f"worst   {result.worst}",
            f"typical {result.typical}",
        ]
    )


def _words(side: Side, gaussians: tuple[int, int]) -> str:
    rows = f"{gaussians[0]:,}" if gaussians[0] == gaussians[1] else f"{gaussians[0]:,} to {gaussians[1]:,}"
    rate = f" at {float(side.fps):g} fps" if side.fps else ""
    name = f"{side.name} {side.rung}" if side.rung else side.name
    count = f"{side.frames} frame{'s' * (side.frames > 1)}{rate}"
    return f"{name}: {count}, {rows} Gaussians of SH degree {side.sh_degree}, {side.bytes_per_frame:,.0f} bytes a frame"


def _decibels(q: Quality) -> str:
    return f"{q.psnr:.2f} dB"


def _claim(b: Side) -> str:
    return f" (B's tables claim {_decibels(b.claimed)})" if b.claimed else ""
