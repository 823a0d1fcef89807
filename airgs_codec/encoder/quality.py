"""Rendered quality of every rung, measured on a written package against the original frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from airgs_codec._sampling import middle_frames
from airgs_codec.decoder.decode import decode_canonical, decode_segment
from airgs_codec.media.color import delta_e
from airgs_codec.media.metrics import mse, psnr, ssim
from airgs_codec.package.store import Package
from airgs_codec.package.tables import Manifest, Quality, Segment, SegmentLevel
from airgs_codec.progress import Progress, silent
from airgs_codec.render import Camera, render
from airgs_codec.scene.gaussians import Gaussians
from airgs_codec.scene.sequence import GaussianSequence


@dataclass(slots=True)
class QualitySums:
    """Adds up what pictures and their references differ by."""

    squared: float = 0.0
    similarity: float = 0.0
    difference: float = 0.0
    count: int = 0

    def add(self, picture: NDArray[np.float32], reference: NDArray[np.float32]) -> None:
        """One (H, W, 3) picture beside the picture of the original."""
        self.squared += mse(picture, reference)
        self.similarity += ssim(picture, reference)
        self.difference += delta_e(picture, reference)
        self.count += 1

    def quality(self) -> Quality:
        """Over all pictures added so far, at least one."""
        count = self.count
        return Quality(psnr(self.squared / count), self.similarity / count, self.difference / count)


def measure_quality(
    package: Package,
    sequence: GaussianSequence,
    cameras: Sequence[Camera],
    frames: int,
    progress: Progress = silent,
) -> Manifest:
    """The package's tables with PSNR, SSIM and CIEDE2000 of every segment, level and key quality.

    PSNR is of the mean squared error, the others are means. The reference is the original after repairs, in at most
    `frames` frames a segment, seen by `cameras`.
    """
    m = package.manifest
    segments: list[Segment] = []
    for index, segment in enumerate(m.segments):
        progress("quality", index, len(m.segments))
        numbers = middle_frames(segment.start, segment.stop, frames)
        originals = sequence.load(numbers).frames
        references = [[render(g, camera).rgb for camera in cameras] for g in originals]
        sums = [[QualitySums() for _ in m.qualities] for _ in m.levels]
        for quality in range(len(m.qualities)):
            for level, wanted in enumerate(m.levels):
                base = decode_canonical(package, segment.group, quality, wanted.tiers)
                shown = list(decode_segment(package, index, base, level, 0, segment.stop - segment.start))
                for number, pictures in zip(numbers, references, strict=True):
                    _compare(shown[number - segment.start], cameras, pictures, sums[level][quality])
        levels = [_with_quality(level, row) for level, row in zip(segment.levels, sums, strict=True)]
        segments.append(replace(segment, levels=levels))
    return replace(m, segments=segments)


def _compare(shown: Gaussians, cameras: Sequence[Camera], references: list, sums: QualitySums) -> None:
    for camera, reference in zip(cameras, references, strict=True):
        sums.add(render(shown, camera).rgb, reference)


def _with_quality(level: SegmentLevel, row: list[QualitySums]) -> SegmentLevel:
    measured = [sums.quality() for sums in row]
    return replace(
        level,
        psnr=[round(q.psnr, 3) for q in measured],
        ssim=[round(q.ssim, 5) for q in measured],
        delta_e=[round(q.delta_e, 4) for q in measured],
    )
