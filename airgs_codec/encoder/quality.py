"""Rendered quality of every rung, measured on a written package against the original frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from airgs_codec.decoder.decode import decode_canonical, decode_segment
from airgs_codec.encoder.views import Pictures, ViewPlan
from airgs_codec.media.color import delta_e
from airgs_codec.media.metrics import Reference, psnr
from airgs_codec.package.store import Package
from airgs_codec.package.tables import Manifest, Quality, Segment, SegmentLevel
from airgs_codec.progress import Progress, silent
from airgs_codec.render import render
from airgs_codec.scene.sequence import GaussianSequence

OFF_LADDER = 5  # one picture in so many measures key qualities that are not those of a level


@dataclass(slots=True)
class QualitySums:
    """Collects what pictures and their references differ by."""

    squared: list[float] = field(default_factory=list)  # mean squared error of each
    similarity: float = 0.0
    difference: float = 0.0

    def add(self, picture: NDArray[np.float32], reference: Reference) -> None:
        """One (H, W, 3) picture beside the picture of the original."""
        self.squared.append(reference.mse(picture))
        self.similarity += reference.ssim(picture)
        self.difference += delta_e(picture, reference.picture)

    def quality(self) -> Quality:
        """Over all pictures added so far, at least one."""
        count = len(self.squared)
        mean, worst = psnr(sum(self.squared) / count), psnr(max(self.squared))
        return Quality(mean, worst, self.similarity / count, self.difference / count)


def measure_quality(
    package: Package, sequence: GaussianSequence, views: ViewPlan, count: int, progress: Progress = silent
) -> Manifest:
    """The package's tables with PSNR, worst picture, SSIM and CIEDE2000 of every segment, level and key quality.

    PSNR is of the mean squared error, SSIM and CIEDE2000 are means. The reference is the original after repairs, in
    `count` pictures a segment, and in one of OFF_LADDER of them for key qualities that are not the level's own.
    """
    m = package.manifest
    segments: list[Segment] = []
    for index, segment in enumerate(m.segments):
        progress("quality", index, len(m.segments))
        pictures = views.measure(index, segment.start, segment.stop, count)
        references = _references(sequence, pictures)
        rows = [
            [_measure(package, index, (level, quality), pictures, references) for quality in range(len(m.qualities))]
            for level in range(len(m.levels))
        ]
        levels = [_with_quality(level, row) for level, row in zip(segment.levels, rows, strict=True)]
        segments.append(replace(segment, levels=levels))
    return replace(m, segments=segments)


def _references(sequence: GaussianSequence, pictures: Pictures) -> list[Reference]:
    """Pictures of the original."""
    numbers = sorted({number for number, _ in pictures})
    originals = dict(zip(numbers, sequence.load(numbers).frames, strict=True))
    return [Reference.of(render(originals[number], camera).rgb) for number, camera in pictures]


def _measure(
    package: Package,
    index: int,
    rung: tuple[int, int],
    pictures: Pictures,
    references: Sequence[Reference],
) -> Quality:
    """Quality of one level at one key quality in a segment."""
    m, (level, quality) = package.manifest, rung
    every = 1 if quality == m.levels[level].quality else OFF_LADDER
    segment = m.segments[index]
    base = decode_canonical(package, segment.group, quality, m.levels[level].tiers)
    compared = list(zip(pictures, references, strict=True))[::every]
    places = sorted({number - segment.start for (number, _), _ in compared})
    shown = dict(zip(places, decode_segment(package, index, base, level, places), strict=True))
    sums = QualitySums()
    for (number, camera), reference in compared:
        sums.add(render(shown[number - segment.start], camera).rgb, reference)
    return sums.quality()


def _with_quality(level: SegmentLevel, row: Sequence[Quality]) -> SegmentLevel:
    return replace(
        level,
        psnr=[round(q.psnr, 2) for q in row],
        worst=[round(q.worst, 2) for q in row],
        ssim=[round(q.ssim, 4) for q in row],
        delta_e=[round(q.delta_e, 2) for q in row],
    )
