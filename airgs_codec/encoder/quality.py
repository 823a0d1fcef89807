"""Rendered quality of every rung, measured on a written package against the original frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from airgs_codec.coding.channels import Canonical
from airgs_codec.decoder.decode import decode_canonical, decode_segment
from airgs_codec.encoder.views import Pictures, ViewPlan
from airgs_codec.media.color import delta_e
from airgs_codec.media.metrics import Reference, psnr
from airgs_codec.package.manifest import Groups, Manifest, Quality
from airgs_codec.package.store import Package
from airgs_codec.package.tables import Segment, SegmentLevel
from airgs_codec.progress import Progress, silent
from airgs_codec.render import Camera, render
from airgs_codec.scene.sequence import GaussianSequence

_Compared = tuple[int, Camera, Reference]  # number of the frame, view, the original's picture

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
        compared = _references(sequence, views.measure(index, segment.start, segment.stop, count))
        bases = [decode_canonical(package, m.group_of(index), quality) for quality in range(len(m.qualities))]
        levels = [
            _with_quality(level, [_measure(package, (index, j, q), base, compared) for q, base in enumerate(bases)])
            for j, level in enumerate(segment.levels)
        ]
        segments.append(replace(segment, levels=levels))
    groups = [
        replace(group, segments=[segments[s] for s in m.segments_of(number)]) for number, group in enumerate(m.groups)
    ]
    return replace(m, groups=Groups.of(groups))


def _references(sequence: GaussianSequence, pictures: Pictures) -> list[_Compared]:
    """The pictures with what the original shows in them."""
    numbers = sorted({number for number, _ in pictures})
    originals = dict(zip(numbers, sequence.load(numbers).frames, strict=True))
    return [(number, camera, Reference.of(render(originals[number], camera).rgb)) for number, camera in pictures]


def _measure(package: Package, rung: tuple[int, int, int], base: Canonical, compared: Sequence[_Compared]) -> Quality:
    """Quality of `rung`, a segment's level at a key quality, over the canonical space of all key tiers."""
    m, (index, level, quality) = package.manifest, rung
    segment = m.segments[index]
    rows = sum(tier.count for tier in m.groups[m.group_of(index)].tiers[: m.levels[level].tiers])
    looked_at = compared if quality == m.levels[level].quality else compared[::OFF_LADDER]
    places = sorted({number - segment.start for number, _, _ in looked_at})
    shown = dict(zip(places, decode_segment(package, index, base.first(rows), level, places), strict=True))
    sums = QualitySums()
    for number, camera, reference in looked_at:
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
