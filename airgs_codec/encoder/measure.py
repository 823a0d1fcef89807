"""Rendered quality of every rung, measured on a written package against the original frames."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from airgs_codec.coding.channels import Canonical
from airgs_codec.decoder.decode import decode_canonical, decode_segment
from airgs_codec.encoder.survey import Pictures, ViewPlan
from airgs_codec.media.metrics import Difference, Quality, pool
from airgs_codec.package.manifest import Groups, Manifest
from airgs_codec.package.package import Package
from airgs_codec.package.tables import Group, Segment, SegmentLevel
from airgs_codec.render.backend import Renderer
from airgs_codec.render.compare import Source, compare, draw_ahead, draw_frames, in_order
from airgs_codec.scene.sequence import GaussianSequence

LOWER = 2  # one picture of the first round in so many measures the rungs below the top one
OFF_LADDER = 6  # one in so many measures key qualities that are not those of a level; a multiple of LOWER
# Relative standard error of the top rung's mean squared error above which more pictures are measured: two are 0.3 dB.
UNSURE = 0.035
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


@dataclass(frozen=True, slots=True)
class Round:
    """Which pictures of every segment are measured: the next ones, after so many rounds of as many."""

    number: int
    count: int  # pictures of a segment, at least


@dataclass(frozen=True, slots=True)
class AskedPictures:
    """What a round measures in a group."""

    pictures: list[Pictures]  # of each segment
    lower: bool  # other rungs than the top one are measured, too


Ask = Callable[[Round], Sequence[RoundErrors]]  # measures a round of some groups


def measure_groups(m: Manifest, numbers: Sequence[int], views: ViewPlan, rounds: Rounds, ask: Ask) -> Measured:
    """Tables of some groups with PSNR, worst picture, SSIM and CIEDE2000 of every segment, level and key quality.

    PSNR is of the mean squared error, SSIM and CIEDE2000 are means. The reference is the original after repairs, in
    `rounds.count` pictures a segment, which `ask` measures; again and again in so many others, until the standard error
    of the top rung is at most UNSURE. Errors are heavy-tailed: a large Gaussian close to a view outweighs many others.

    Lower rungs are measured in one of LOWER pictures of the first round alone, key qualities that are not the level's
    own in one of OFF_LADDER. Their squared errors are scaled by what the error of the top rung in all pictures, or of
    the level's own quality, is to its error in these (a ratio estimator; Cochran, Sampling Techniques, 1977, chapter
    6), since a view that is hard for one rung is hard for all.
    """
    indices = [s for number in numbers for s in m.segments_of(number)]
    errors: dict[int, SegmentErrors] = {s: [[[] for _ in m.qualities] for _ in m.levels] for s in indices}
    for done in range(rounds.most):
        found = [of_segment for of_group in ask(Round(done, rounds.count)) for of_segment in of_group]
        for index, of_segment in zip(indices, found, strict=True):
            for mine, new in zip(itertools.chain(*errors[index]), itertools.chain(*of_segment), strict=True):
                mine += new
        unsure = _standard_error(m, errors)
        if done + 1 >= rounds.least and unsure <= UNSURE:
            break
    turn = views.measured(rounds.count)
    groups = []
    for number in numbers:
        segments = [_with_errors(m, m.segments[s], errors[s], turn) for s in m.segments_of(number)]
        groups.append(replace(m.groups[number], segments=segments))
    pictures = (done + 1) * turn
    return Measured(groups, pictures, unsure if pictures > 1 else math.nan)


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
    return AskedPictures(pictures, lower=asked.number == 0)


def measure_round(
    package: Package, sequence: GaussianSequence, renderer: Renderer, group: int, asked: AskedPictures
) -> RoundErrors:
    """Render the rungs of a group of a package beside the original; those that are not asked for have no errors."""
    m, found = package.manifest, []
    bases = [decode_canonical(package, group, quality) for quality in range(len(m.qualities))]
    for index, pictures in zip(m.segments_of(group), asked.pictures, strict=True):
        originals = draw_ahead(_originals(sequence, pictures, renderer), pictures)
        errors: SegmentErrors = [[[] for _ in m.qualities] for _ in m.levels]
        for j, quality in itertools.product(range(len(m.levels)), range(len(bases))):
            looked_at = pictures[:: _stride(m, j, quality)]
            if asked.lower or _is_top(m, j, quality):
                shown = _rung(package, (index, j), bases[quality], looked_at, renderer)
                errors[j][quality] = list(compare(originals, shown, looked_at, Difference.of))
        found.append(errors)
    return found


def _is_top(m: Manifest, level: int, quality: int) -> bool:
    """Whether this is the rung that every picture measures."""
    return level == 0 and quality == m.levels[0].quality


def _stride(m: Manifest, level: int, quality: int) -> int:
    """Of so many pictures of a round one measures a level in a key quality."""
    if quality != m.levels[level].quality:
        return OFF_LADDER
    return 1 if level == 0 else LOWER


def _standard_error(m: Manifest, errors: Mapping[int, SegmentErrors]) -> float:
    """Relative standard error of the top rung's mean squared error, from the errors of segments; 0 without error."""
    frames = np.array([m.segments[s].stop - m.segments[s].start for s in errors])
    weights = frames / frames.sum()
    squared = [[picture.mse for picture in of[0][m.levels[0].quality]] for of in errors.values()]
    mean = float(weights @ [np.mean(of) for of in squared])
    variance = float(weights**2 @ [np.var(of) / max(1, len(of) - 1) for of in squared])
    return variance**0.5 / mean if mean else 0.0


def _with_errors(m: Manifest, segment: Segment, errors: SegmentErrors, turn: int) -> Segment:
    """A segment with the quality that was measured, `turn` pictures at a time."""
    top = errors[0][m.levels[0].quality]
    levels = []
    for j, level in enumerate(segment.levels):
        own = m.levels[j].quality
        first = errors[j][own][: -(-turn // _stride(m, j, own))]  # of the first round
        scale = _ratio(top, top[:turn:LOWER]) if j else 1.0
        others = scale * _ratio(errors[j][own], first[:: OFF_LADDER // _stride(m, j, own)])
        row = [pool(of, scale if q == own else others) for q, of in enumerate(errors[j])]
        levels.append(_with_quality(level, row))
    return replace(segment, levels=levels)


def _ratio(everywhere: Sequence[Difference], some: Sequence[Difference]) -> float:
    """What the mean squared error of all pictures is to that of some of them; 1 where these show no error."""
    part = np.mean([picture.mse for picture in some])
    return float(np.mean([picture.mse for picture in everywhere]) / part) if part else 1.0


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
