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
from airgs_codec.encoder.doubt import Rung, RungSeen, Seen, doubt_of_ratio, doubt_of_top, ratio_of
from airgs_codec.encoder.survey import Pictures, ViewPlan
from airgs_codec.media.metrics import Difference, Picture, pool, psnr
from airgs_codec.package.manifest import Groups, Manifest, on_ladder
from airgs_codec.package.package import Package
from airgs_codec.package.tables import Group, Segment
from airgs_codec.render.backend import Renderer
from airgs_codec.render.compare import Source, compare, draw_frames, draw_once, in_order
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


Strides = Mapping[Rung, int]  # one picture in so many measures a rung; none does of those that are not there


@dataclass(frozen=True, slots=True)
class Round:
    """Which pictures of every segment are measured: the next ones, after so many rounds of as many."""

    number: int
    count: int  # pictures of a segment, at least
    strides: Strides


@dataclass(frozen=True, slots=True)
class AskedPictures:
    """What a round measures in a group."""

    pictures: list[Pictures]  # of each segment
    strides: tuple[tuple[int, int, int], ...]  # level, key quality and stride
    alike: bool  # SSIM and CIEDE2000 are measured, too


@dataclass(frozen=True, slots=True)
class RungErrors:
    """What some pictures of a segment show of a rung."""

    squared: list[float]  # mean squared errors
    alike: list[Difference]  # of these pictures, where SSIM and CIEDE2000 are measured


SegmentErrors = list[RungErrors]  # of a segment, in the order of the strides
RoundErrors = list[SegmentErrors]  # of the segments of a group
Ask = Callable[[Round], Sequence[RoundErrors]]  # measures a round of some groups


@dataclass(frozen=True, slots=True)
class QualityQuery:
    """Groups of a package whose quality is asked for, in `rounds.count` pictures a segment and round."""

    manifest: Manifest
    numbers: Sequence[int]
    views: ViewPlan
    rounds: Rounds
    ask: Ask

    @property
    def shares(self) -> NDArray[np.float64]:
        """(S,) share of each segment in the frames of all."""
        segments = [self.manifest.segments[s] for s in self.segments]
        frames = np.array([segment.stop - segment.start for segment in segments])
        return frames / frames.sum()

    @property
    def segments(self) -> list[int]:
        """Numbers of the segments of all groups."""
        return [s for number in self.numbers for s in self.manifest.segments_of(number)]


@dataclass(frozen=True, slots=True)
class TopMeasured:
    """What pictures of the top rung show."""

    seen: Seen
    rounds: int
    unsure: float  # relative standard error of its mean squared error; infinite: one picture tells none
    psnr: float  # of all segments, dB
    delta_e: float


@dataclass(frozen=True, slots=True, eq=False)
class Measured:
    """Groups whose quality is known."""

    groups: list[Group]
    pictures: int  # of each segment that were measured
    unsure: float  # as in `TopMeasured`

    def whole(self, m: Manifest) -> Manifest:
        """The tables of a package of which these are all groups."""
        return replace(m, groups=Groups.of(self.groups), views=replace(m.views, measured=self.pictures))


def measure_top(query: QualityQuery) -> TopMeasured:
    """Measure the top rung in ever more pictures until its standard error is at most UNSURE.

    PSNR is of the mean squared error, SSIM and CIEDE2000 are means over the pictures of the first round. The reference
    is the original after repairs. Errors are heavy-tailed: a large Gaussian close to a view outweighs many others.
    """
    top, shares = _top(query.manifest), query.shares
    seen: Seen = {s: {top: RungSeen()} for s in query.segments}
    for done in itertools.count(1):
        _look(query, Round(done - 1, query.rounds.count, {top: 1}), seen)
        parts = [of[top] for of in seen.values()]
        unsure = doubt_of_top(parts, shares)
        if done >= query.rounds.most or (done >= query.rounds.least and unsure <= UNSURE):
            break
    error, colour = shares @ [(np.mean(p.squared), pool(p.alike).delta_e) for p in parts]
    return TopMeasured(seen, done, unsure, psnr(float(error)), float(colour))


def measure_groups(query: QualityQuery) -> Measured:
    """Tables of the groups with PSNR, worst picture, SSIM and CIEDE2000 of every segment, level and key quality.

    The top rung is measured first; rungs below it in one of LOWER pictures of the first round, key qualities that are
    not the level's own in one of OFF_LADDER; then all that no mixture of others beats in further rounds, until their
    standard error is at most UNSURE_LOWER. Their squared errors are scaled by what the error of the top rung in all
    pictures is to its error in these (a ratio estimator; Cochran, Sampling Techniques, 1977, chapter 6), since a view
    that is hard for one rung is hard for all.
    """
    m, first, top = query.manifest, _top(query.manifest), measure_top(query)
    seen = {s: {rung: RungSeen() for rung in _rungs(m)} | of for s, of in top.seen.items()}
    strides, rounds = _first_strides(m), top.rounds
    for number in range(query.rounds.most):
        if not strides:
            break
        if number == rounds:
            strides, rounds = {first: 1} | strides, rounds + 1
        _look(query, Round(number, query.rounds.count, strides), seen)
        strides = dict.fromkeys(_unsure(query, seen), 1)
    groups = []
    for number in query.numbers:
        segments = [_with_errors(m, m.segments[s], seen[s]) for s in m.segments_of(number)]
        groups.append(replace(m.groups[number], segments=segments))
    unsure = doubt_of_top([of[first] for of in seen.values()], query.shares)
    return Measured(groups, rounds * query.views.measured(query.rounds.count), unsure)


def _top(m: Manifest) -> Rung:
    return 0, m.levels[0].quality


def _rungs(m: Manifest) -> list[Rung]:
    return list(itertools.product(range(len(m.levels)), range(len(m.qualities))))


def _first_strides(m: Manifest) -> dict[Rung, int]:
    """Strides of all rungs but the top one in the first round."""
    return {(j, q): LOWER if q == m.levels[j].quality else OFF_LADDER for j, q in _rungs(m) if (j, q) != _top(m)}


def first_rounds(m: Manifest, count: int) -> list[Round]:
    """Those that measure every rung of a package once."""
    return [Round(0, count, strides) for strides in ({_top(m): 1}, _first_strides(m)) if strides]


def pictures_of(views: ViewPlan, m: Manifest, group: int, asked: Round, total: int) -> AskedPictures:
    """Draw the pictures of a round for each segment of a group of a package, which has `total` segments in the end."""
    first = asked.number * total + m.segments_of(group).start
    pictures = [
        views.measure(first + place, segment.start, segment.stop, asked.count, asked.number)
        for place, segment in enumerate(m.groups[group].segments)
    ]
    strides = tuple((level, quality, stride) for (level, quality), stride in asked.strides.items())
    return AskedPictures(pictures, strides, asked.number == 0)


def measure_round(
    package: Package, sequence: GaussianSequence, renderer: Renderer, group: int, asked: AskedPictures
) -> RoundErrors:
    """Render rungs of a group of a package beside the original."""
    m, found, every = package.manifest, [], math.gcd(*(stride for *_, stride in asked.strides))
    bases = {quality: decode_canonical(package, group, quality) for quality in {q for _, q, _ in asked.strides}}
    for index, pictures in zip(m.segments_of(group), asked.pictures, strict=True):
        originals = draw_once(_originals(sequence, pictures[::every], renderer))
        errors: SegmentErrors = []
        for level, quality, stride in asked.strides:
            looked_at = pictures[::stride]
            shown = _rung(package, (index, level), bases[quality], looked_at, renderer)
            if asked.alike:
                alike = list(compare(originals, shown, looked_at, Difference.of))
                errors.append(RungErrors([d.mse for d in alike], alike))
            else:
                errors.append(RungErrors(list(compare(originals, shown, looked_at, Picture.mse)), []))
        found.append(errors)
    return found


def _look(query: QualityQuery, asked: Round, seen: Seen) -> None:
    """Measure a round, and add what it shows to what was seen before."""
    m, top = query.manifest, _top(query.manifest)
    count, turn = query.views.measured(asked.count), asked.number * len(m.segments)
    for group, found in zip(query.numbers, query.ask(asked), strict=True):
        for segment, errors in zip(m.segments_of(group), found, strict=True):
            places = query.views.places_of(turn + segment, asked.count)
            by_rung = dict(zip(asked.strides, errors, strict=True))
            of = seen[segment]
            whole = by_rung[top].squared if top in by_rung else of[top].squared[asked.number * count :][:count]
            for rung, stride in asked.strides.items():
                of[rung].squared.extend(by_rung[rung].squared)
                of[rung].alike.extend(by_rung[rung].alike)
                of[rung].top.extend(whole[::stride])
                of[rung].places.extend(places[::stride])


def _unsure(query: QualityQuery, seen: Seen) -> list[Rung]:
    """The rungs below the top one that are unsure, of those that would be on the ladder, so far as is known."""
    m, rungs, shares = query.manifest, _rungs(query.manifest), query.shares
    parts = {rung: [of[rung] for of in seen.values()] for rung in rungs}
    errors = [shares @ [ratio_of(of, of[rung]) * np.mean(of[rung].squared) for of in seen.values()] for rung in rungs]
    sizes = [m.bytes_of(m.rung_files(q, j, query.numbers)) for j, q in rungs]
    ladder = on_ladder(list(zip(sizes, map(psnr, errors), strict=True)))
    certain = doubt_of_top(parts[_top(m)], shares)
    return [
        rung
        for rung, counts in zip(rungs, ladder, strict=True)
        if counts and rung != _top(m) and math.hypot(certain, doubt_of_ratio(parts[rung], shares)) > UNSURE_LOWER
    ]


def _with_errors(m: Manifest, segment: Segment, of: Mapping[Rung, RungSeen]) -> Segment:
    """A segment with the quality that was measured."""
    levels = []
    for j, level in enumerate(segment.levels):
        row = [of[j, q] for q in range(len(m.qualities))]
        scaled = [ratio_of(of, part) * np.array(part.squared) for part in row]
        alike = [pool(part.alike) for part in row]
        levels.append(
            replace(
                level,
                psnr=[round(psnr(float(squared.mean())), 2) for squared in scaled],
                worst=[round(psnr(float(squared.max())), 1) for squared in scaled],
                ssim=[round(quality.ssim, 4) for quality in alike],
                delta_e=[round(quality.delta_e, 2) for quality in alike],
            )
        )
    return replace(segment, levels=levels)


def _originals(sequence: GaussianSequence, pictures: Pictures, renderer: Renderer) -> Source:
    """Draw the original in some pictures, whose frames are repaired together."""
    numbers = sorted({number for number, _ in pictures})
    frames = sequence.load(numbers).frames
    return draw_frames(lambda number: frames[numbers.index(number)], renderer)


def _rung(package: Package, rung: tuple[int, int], base: Canonical, pictures: Pictures, renderer: Renderer) -> Source:
    """Draw `rung`, a segment's level over the canonical space of all key tiers in a key quality, in some pictures.

    They are asked for in their order, by ascending frames.
    """
    m, (index, level) = package.manifest, rung
    segment = m.segments[index]
    tiers = m.groups[m.group_of(index)].tiers[: m.levels[level].tiers]
    numbers = sorted({number for number, _ in pictures})
    fewer = base.first(sum(tier.count for tier in tiers))
    frames = decode_segment(package, index, fewer, level, [number - segment.start for number in numbers])
    return draw_frames(in_order(numbers, frames), renderer)
