"""Rendered quality of every rung, measured on a written package against the original frames."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from airgs_codec.coding.channels import Canonical
from airgs_codec.decoder.decode import decode_canonical, decode_segment
from airgs_codec.encoder.survey import Pictures, ViewPlan
from airgs_codec.media.metrics import Difference, Quality, pool, psnr
from airgs_codec.package.manifest import Groups, Manifest, on_ladder
from airgs_codec.package.package import Package
from airgs_codec.package.tables import Group, Segment, SegmentLevel
from airgs_codec.render.backend import Renderer
from airgs_codec.render.compare import Source, compare, draw_ahead, draw_frames, in_order
from airgs_codec.scene.sequence import GaussianSequence

LOWER = 2  # one picture of the first round in so many measures the rungs below the top one
OFF_LADDER = 6  # one in so many measures key qualities that are not those of a level
# Relative standard errors of a mean squared error above which more pictures are measured: two are 0.3 dB of the top
# rung, 0.5 dB of others.
UNSURE = 0.035
UNSURE_LOWER = 0.06
ROUNDS = 12  # of pictures, at most


@dataclass(frozen=True, slots=True)
class Rounds:
    """How many pictures of a segment are measured."""

    count: int  # in a round, at least
    least: int = 1  # rounds
    most: int = ROUNDS

    def again(self, rounds: int) -> Rounds:
        """So many rounds, whatever their errors."""
        return Rounds(self.count, rounds, rounds)


SegmentErrors = list[list[list[Difference]]]  # level x key quality x picture, of one segment
RoundErrors = list[SegmentErrors]  # of the segments of a group
Pair = tuple[Difference, Difference]  # of a rung, and of the top one in the same picture
SegmentPairs = list[list[list[Pair]]]  # level x key quality x picture, of one segment
Strides = tuple[tuple[int, ...], ...]  # level x key quality: one picture in so many measures the rung; 0: none does


@dataclass(frozen=True, slots=True)
class Round:
    """Which pictures of every segment are measured: the next ones, after so many rounds of as many."""

    number: int
    count: int  # pictures of a segment, at least
    strides: Strides  # of the rungs that are measured; 1 of the top one

    @classmethod
    def first(cls, m: Manifest, count: int) -> Round:
        """The one that measures every rung of a package."""
        strides = [[OFF_LADDER] * len(m.qualities) for _ in m.levels]
        for j, level in enumerate(m.levels):
            strides[j][level.quality] = LOWER if j else 1
        return cls(0, count, tuple(map(tuple, strides)))


@dataclass(frozen=True, slots=True)
class AskedPictures:
    """What a round measures in a group."""

    pictures: list[Pictures]  # of each segment
    strides: Strides


Ask = Callable[[Round], Sequence[RoundErrors]]  # measures a round of some groups


def measure_groups(m: Manifest, numbers: Sequence[int], views: ViewPlan, rounds: Rounds, ask: Ask) -> Measured:
    """Tables of some groups with PSNR, worst picture, SSIM and CIEDE2000 of every segment, level and key quality.

    PSNR is of the mean squared error, SSIM and CIEDE2000 are means. The reference is the original after repairs, in
    `rounds.count` pictures a segment, which `ask` measures; again and again in so many others, until the standard error
    of the top rung is at most UNSURE, and of all that no mixture of others beats at most UNSURE_LOWER. Errors are
    heavy-tailed: a large Gaussian close to a view outweighs many others.

    Rungs below the top one are measured in one of LOWER pictures of the first round, key qualities that are not the
    level's own in one of OFF_LADDER, and in later rounds those alone that are unsure. Their squared errors are scaled
    by what the error of the top rung in all pictures is to its error in these (a ratio estimator; Cochran, Sampling
    Techniques, 1977, chapter 6), since a view that is hard for one rung is hard for all.
    """
    indices = [s for number in numbers for s in m.segments_of(number)]
    pairs: dict[int, SegmentPairs] = {s: [[[] for _ in m.qualities] for _ in m.levels] for s in indices}
    asked, done, top = Round.first(m, rounds.count), 0, m.levels[0].quality
    while any(map(any, asked.strides)) and done < rounds.most:
        found = [of_segment for of_group in ask(asked) for of_segment in of_group]
        for index, of_segment in zip(indices, found, strict=True):
            for j, q in itertools.product(range(len(m.levels)), range(len(m.qualities))):
                if stride := asked.strides[j][q]:
                    pairs[index][j][q] += zip(of_segment[j][q], of_segment[0][top][::stride], strict=True)
        done += 1
        asked = Round(done, rounds.count, _unsure(m, numbers, pairs, done < rounds.least))
    groups = []
    for number in numbers:
        segments = [_with_errors(m.segments[s], pairs[s]) for s in m.segments_of(number)]
        groups.append(replace(m.groups[number], segments=segments))
    pictures = done * views.measured(rounds.count)
    return Measured(groups, pictures, _doubt_of_top(m, pairs) if pictures > 1 else math.nan)


@dataclass(frozen=True, slots=True, eq=False)
class Measured:
    """Groups whose quality is known."""

    groups: list[Group]
    pictures: int  # of each segment that were measured
    unsure: float  # relative standard error of the top rung's mean squared error; NaN: one picture tells none

    def whole(self, m: Manifest) -> Manifest:
        """The tables of a package of which these are all groups."""
        return replace(m, groups=Groups.of(self.groups), views=replace(m.views, measured=self.pictures))


def doubt_db(unsure: float) -> float:
    """Two relative standard errors of a mean squared error, in dB of PSNR."""
    return 10 * math.log10(1 + 2 * unsure)


def pictures_of(views: ViewPlan, m: Manifest, group: int, asked: Round, total: int) -> AskedPictures:
    """Draw the pictures of a round for each segment of a group of a package, which has `total` segments in the end."""
    first = asked.number * total + m.segments_of(group).start
    pictures = [
        views.measure(first + place, segment.start, segment.stop, asked.count, asked.number)
        for place, segment in enumerate(m.groups[group].segments)
    ]
    return AskedPictures(pictures, asked.strides)


def measure_round(
    package: Package, sequence: GaussianSequence, renderer: Renderer, group: int, asked: AskedPictures
) -> RoundErrors:
    """Render the rungs of a group of a package beside the original; those that are not asked for have no errors."""
    m, found = package.manifest, []
    used = [q for q in range(len(m.qualities)) if any(of_level[q] for of_level in asked.strides)]
    bases = {quality: decode_canonical(package, group, quality) for quality in used}
    for index, pictures in zip(m.segments_of(group), asked.pictures, strict=True):
        originals = draw_ahead(_originals(sequence, pictures, renderer), pictures)
        errors: SegmentErrors = [[[] for _ in m.qualities] for _ in m.levels]
        for j, quality in itertools.product(range(len(m.levels)), used):
            if stride := asked.strides[j][quality]:
                looked_at = pictures[::stride]
                shown = _rung(package, (index, j), bases[quality], looked_at, renderer)
                errors[j][quality] = list(compare(originals, shown, looked_at, Difference.of))
        found.append(errors)
    return found


def _unsure(m: Manifest, numbers: Sequence[int], pairs: Mapping[int, SegmentPairs], again: bool) -> Strides:
    """What the next round measures: the top rung and all that are unsure, or nothing where none is, nor asks `again`.

    Of the others those count alone that would be on the ladder, so far as is known.
    """
    levels, qualities = range(len(m.levels)), range(len(m.qualities))
    rungs, top, certain = list(itertools.product(levels, qualities)), (0, m.levels[0].quality), _doubt_of_top(m, pairs)
    sizes = [m.bytes_of(m.rung_files(q, j, numbers)) for j, q in rungs]
    shown = [psnr(float(_weights(m, pairs) @ [_scaled(of, j, q) for of in pairs.values()])) for j, q in rungs]
    ladder = on_ladder(list(zip(sizes, shown, strict=True)))
    asked = {
        rung
        for rung, counts in zip(rungs, ladder, strict=True)
        if counts and rung != top and math.hypot(certain, _doubt_of_ratio(m, pairs, *rung)) > UNSURE_LOWER
    }
    if asked or again or certain > UNSURE:
        asked.add(top)
    return tuple(tuple(int((j, q) in asked) for q in qualities) for j in levels)


def _weights(m: Manifest, pairs: Mapping[int, SegmentPairs]) -> NDArray[np.float64]:
    """(S,) share of each segment in the frames of all."""
    frames = np.array([m.segments[s].stop - m.segments[s].start for s in pairs])
    return frames / frames.sum()


def _doubt_of_top(m: Manifest, pairs: Mapping[int, SegmentPairs]) -> float:
    """Relative standard error of the top rung's mean squared error, from the errors of segments; 0 without error."""
    weights = _weights(m, pairs)
    squared = [[own.mse for own, _ in of[0][m.levels[0].quality]] for of in pairs.values()]
    mean = float(weights @ [np.mean(of) for of in squared])
    variance = float(weights**2 @ [np.var(of) / max(1, len(of) - 1) for of in squared])
    return variance**0.5 / mean if mean else 0.0


def _doubt_of_ratio(m: Manifest, pairs: Mapping[int, SegmentPairs], level: int, quality: int) -> float:
    """Relative standard error of what a rung's mean squared error is to that of the top one; 0 without error.

    One ratio for all segments: what is left of errors then is at most too large where segments have others.
    """
    squared = [np.array([(own.mse, top.mse) for own, top in of[level][quality]]) for of in pairs.values()]
    weights, counts = _weights(m, pairs), np.array([len(of) for of in squared])
    own, top = weights @ [of.mean(axis=0) for of in squared]
    if not own:
        return 0.0
    left = np.concatenate([of[:, 0] - (own / top * of[:, 1] if top else own) for of in squared])
    variance = float(left @ left) / max(1, len(left) - 1)
    return float((variance * (weights**2 / counts).sum()) ** 0.5 / own)


def _scaled(pairs: SegmentPairs, level: int, quality: int) -> float:
    """Mean squared error of a rung of a segment, as all pictures would show it."""
    return _ratio(pairs, level, quality) * float(np.mean([own.mse for own, _ in pairs[level][quality]]))


def _ratio(pairs: SegmentPairs, level: int, quality: int) -> float:
    """What the top rung's mean squared error in all pictures of a segment is to that in those of a rung.

    1 where these show no error. The top rung is the one with most pictures.
    """
    everywhere = max(itertools.chain(*pairs), key=len)
    part = np.mean([top.mse for _, top in pairs[level][quality]])
    return float(np.mean([top.mse for _, top in everywhere]) / part) if part else 1.0


def _with_errors(segment: Segment, pairs: SegmentPairs) -> Segment:
    """A segment with the quality that was measured."""
    levels = []
    for j, level in enumerate(segment.levels):
        row = [pool([own for own, _ in of], _ratio(pairs, j, q)) for q, of in enumerate(pairs[j])]
        levels.append(_with_quality(level, row))
    return replace(segment, levels=levels)


def _originals(sequence: GaussianSequence, pictures: Pictures, renderer: Renderer) -> Source:
    """Draw the original in some pictures, whose frames are repaired together."""
    numbers = sorted({number for number, _ in pictures})
    frames = sequence.load(numbers).frames
    return draw_frames(lambda number: frames[numbers.index(number)], renderer)


def _rung(package: Package, rung: tuple[int, int], base: Canonical, pictures: Pictures, renderer: Renderer) -> Source:
    """Draw `rung`, a segment's level over the canonical space of all units in a key quality, in some pictures.

    They are asked for in their order, by ascending frames.
    """
    m, (index, level) = package.manifest, rung
    segment = m.segments[index]
    fewer = _fewer_tiers(m.groups[m.group_of(index)], base, m.levels[level].tiers)
    numbers = sorted({number for number, _ in pictures})
    frames = decode_segment(package, index, fewer, level, [number - segment.start for number in numbers])
    return draw_frames(in_order(numbers, frames), renderer)


def _fewer_tiers(group: Group, base: Canonical, tiers: int) -> Canonical:
    """The canonical space that the first `tiers` key tiers of all tiles make, of the one that all tiers make."""
    counts = [tier.count for tier in group.units]
    if len(group.tiles) == 1:
        return base.first(sum(counts[:tiers]))
    there = [unit % len(group.tiles[0].tiers) < tiers for unit in range(len(counts))]
    return base.part(np.flatnonzero(np.repeat(there, counts)))


def _with_quality(level: SegmentLevel, row: Sequence[Quality]) -> SegmentLevel:
    """An entry of a level with its quality at each key quality."""
    return replace(
        level,
        psnr=[round(q.psnr, 2) for q in row],
        worst=[round(q.worst, 2) for q in row],
        ssim=[round(q.ssim, 4) for q in row],
        delta_e=[round(q.delta_e, 2) for q in row],
    )
