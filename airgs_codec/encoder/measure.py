"""Rendered quality of every rung of a finished package, measured once against the original frames.

A rung is (level, key quality). S segments.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from airgs_codec.coding.channels import Canonical
from airgs_codec.decoder.decode import decode_canonical, decode_segment
from airgs_codec.encoder.survey import Pictures, ViewPlan
from airgs_codec.media.metrics import Difference, pool, psnr, squared_error
from airgs_codec.package.manifest import Groups, Manifest
from airgs_codec.package.package import Package
from airgs_codec.package.region import GUESSED
from airgs_codec.package.tables import Group, Segment
from airgs_codec.render.backend import Renderer
from airgs_codec.render.compare import Source, compare, draw_frames, draw_once, in_order
from airgs_codec.scene.sequence import GaussianSequence

LOWER = 2  # one picture in so many measures the rungs below the top one
OFF_LADDER = 6  # one in so many measures a level in a key quality that is not its own

Rung = tuple[int, int]
RungErrors = list[list[list[Difference]]]  # of each segment of a group, of each rung in the order of `strides_of`


@dataclass(frozen=True, slots=True, eq=False)
class Measured:
    manifest: Manifest
    uncertainty: float  # relative standard error of the mean squared error of the top rung; infinite: of one picture


def pictures_a_segment(pictures: int, segments: int) -> int:
    """How many pictures each segment needs, so that all of them have `pictures` together."""
    return -(-pictures // segments)


def strides_of(m: Manifest) -> dict[Rung, int]:
    """One picture in so many measures a rung, the top one first."""
    top = (0, m.levels[0].quality)
    rungs = itertools.product(range(len(m.levels)), range(len(m.qualities)))
    others = {(j, q): LOWER if q == m.levels[j].quality else OFF_LADDER for j, q in rungs if (j, q) != top}
    return {top: 1} | others


def pictures_of(views: ViewPlan, m: Manifest, group: int, count: int) -> list[Pictures]:
    """Draws `count` pictures of each segment of a group: frames of it, each from a view of its own."""
    segments = zip(m.segments_of(group), m.groups[group].segments, strict=True)
    return [views.measure(number, segment.start, segment.stop, count) for number, segment in segments]


def measure_group(
    package: Package, sequence: GaussianSequence, renderer: Renderer, group: int, pictures: Sequence[Pictures]
) -> RungErrors:
    """Errors of every rung in pictures of each segment of a group, against the original frames after repairs."""
    m, found = package.manifest, []
    strides = strides_of(m)
    bases = {quality: decode_canonical(package, group, quality) for quality in {q for _, q in strides}}
    for index, of_segment in zip(m.segments_of(group), pictures, strict=True):
        originals = draw_once(_originals(sequence, of_segment, renderer))
        errors = []
        for (level, quality), stride in strides.items():
            looked_at = of_segment[::stride]
            shown = _shown(package, (index, level), bases[quality], looked_at, renderer)
            errors.append(list(compare(originals, shown, looked_at, Difference.of)))
        found.append(errors)
    return found


def with_errors(m: Manifest, group: int, errors: RungErrors) -> Group:
    """The table of a group with PSNR, worst picture, SSIM and CIEDE2000 of every segment, level and key quality.

    PSNR is of the mean squared error over pictures, SSIM and CIEDE2000 are means. Squared errors of a rung that fewer
    pictures measure are scaled by what the error of the top rung in all pictures is to its error in these (a ratio
    estimator; Cochran, Sampling Techniques, 1977, chapter 6), since a view that is hard for one rung is hard for all.
    Where views were guessed, the harder half of them alone tells the PSNR: those from where the scene was filmed may
    be among the harder ones.
    """
    segments = zip(m.groups[group].segments, errors, strict=True)
    return replace(m.groups[group], segments=[_segment_with(m, segment, of) for segment, of in segments])


def _segment_with(m: Manifest, segment: Segment, errors: Sequence[Sequence[Difference]]) -> Segment:
    strides = strides_of(m)
    shows = np.array([not difference.blank for difference in errors[0]])
    shows |= not shows.any()
    top = np.array([difference.mse for difference in errors[0]])[shows]
    guessed = m.region.source in GUESSED and top.any()
    harder = np.sort(top)[len(top) // 2 :].mean() / top.mean() if guessed else 1.0
    found = {}
    for (rung, stride), differences in zip(strides.items(), errors, strict=True):
        in_these = np.mean([one.mse for one in errors[0][::stride] if not one.blank] or [0.0])
        scale = top.mean() / in_these if in_these else 1.0
        found[rung] = pool([replace(one, mse=scale * one.mse) for one in differences])
    levels = []
    for j, level in enumerate(segment.levels):
        row = [found[j, q] for q in range(len(m.qualities))]
        levels.append(
            replace(
                level,
                psnr=[round(psnr(harder * squared_error(quality.psnr)), 2) for quality in row],
                worst=[round(quality.worst, 1) for quality in row],
                ssim=[round(quality.ssim, 4) for quality in row],
                delta_e=[round(quality.delta_e, 2) for quality in row],
            )
        )
    return replace(segment, levels=levels)


def with_quality(m: Manifest, errors: Sequence[RungErrors], count: int) -> Measured:
    """A package with the quality that `count` pictures of each segment of all its groups have shown."""
    groups = Groups.of([with_errors(m, group, of) for group, of in enumerate(errors)])
    measured = replace(m, groups=groups, views=replace(m.views, measured=count))
    return Measured(measured, _uncertainty(m, [of_segment[0] for of_group in errors for of_segment in of_group]))


def _uncertainty(m: Manifest, errors: Sequence[Sequence[Difference]]) -> float:
    """Relative standard error of the mean squared error, of some pictures of each segment, over all frames.

    Pictures count by the frames that they stand for (Cochran, Sampling Techniques, 1977, section 2.11).
    """
    squared = np.array([one.mse for of in errors for one in of])
    frames = [segment.stop - segment.start for segment in m.segments]
    shares = np.array([count / len(of) for count, of in zip(frames, errors, strict=True) for _ in of]) / sum(frames)
    mean, pictures = float(shares @ squared), len(squared)
    if pictures < 2:
        return math.inf
    spread = float(shares**2 @ (squared - mean) ** 2) * pictures / (pictures - 1)
    return spread**0.5 / mean if mean else 0.0


def uncertainty_db(uncertainty: float) -> float:
    """Two relative standard errors of a mean squared error, in dB of PSNR."""
    return 10 * math.log10(1 + 2 * uncertainty)


def _originals(sequence: GaussianSequence, pictures: Pictures, renderer: Renderer) -> Source:
    """Draws the original in some pictures, whose frames are repaired together."""
    numbers = sorted({number for number, _ in pictures})
    frames = sequence.load(numbers).frames
    return draw_frames(lambda number: frames[numbers.index(number)], renderer)


def _shown(package: Package, of: tuple[int, int], base: Canonical, pictures: Pictures, renderer: Renderer) -> Source:
    """Draws a level of a segment, `of`, over the canonical space of all key tiers in a key quality, in some pictures.

    They are asked for in their order, by ascending frames.
    """
    m, (index, level) = package.manifest, of
    segment = m.segments[index]
    tiers = m.groups[m.group_of(index)].tiers[: m.levels[level].tiers]
    numbers = sorted({number for number, _ in pictures})
    fewer = base.part(slice(sum(tier.count for tier in tiers)))
    frames = decode_segment(package, index, fewer, level, [number - segment.start for number in numbers])
    return draw_frames(in_order(numbers, frames), renderer)
