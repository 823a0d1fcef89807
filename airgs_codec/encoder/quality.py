"""Rendered quality of every rung, measured on a written package against the original frames."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from airgs_codec.coding.channels import Canonical
from airgs_codec.decoder.decode import decode_canonical, decode_segment, fewer_tiers
from airgs_codec.encoder.views import Pictures, ViewPlan
from airgs_codec.media.color import delta_e
from airgs_codec.media.metrics import Reference, psnr
from airgs_codec.package.manifest import Groups, Manifest, Quality
from airgs_codec.package.store import Package
from airgs_codec.package.tables import Group, Segment, SegmentLevel
from airgs_codec.render import Camera
from airgs_codec.render.backend import Renderer
from airgs_codec.scene.sequence import GaussianSequence

_Compared = tuple[int, Camera, Reference]  # number of the frame, view, the original's picture

OFF_LADDER = 5  # one picture in so many measures key qualities that are not those of a level
UNSURE = 0.06  # relative standard error of the top rung's mean squared error from which more pictures are measured
ROUNDS = 4  # of pictures, at most


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

    def extend(self, other: QualitySums) -> None:
        """The pictures of another."""
        self.squared += other.squared
        self.similarity += other.similarity
        self.difference += other.difference

    def quality(self, scale: float = 1.0) -> Quality:
        """Over all pictures added so far, at least one; squared errors are multiplied by `scale`."""
        count = len(self.squared)
        mean, worst = psnr(scale * sum(self.squared) / count), psnr(scale * max(self.squared))
        return Quality(mean, worst, self.similarity / count, self.difference / count)


@dataclass(frozen=True, slots=True)
class Rounds:
    """How many pictures of a segment are measured."""

    count: int  # in a round, at least
    least: int = 1  # rounds
    most: int = ROUNDS

    def again(self, rounds: int) -> Rounds:
        """So many rounds, whatever their errors."""
        return Rounds(self.count, rounds, rounds)


SegmentSums = list[list[QualitySums]]  # level x key quality, of one segment
RoundSums = list[SegmentSums]  # of the segments of a group


@dataclass(frozen=True, slots=True)
class Round:
    """Which pictures of every segment are measured: the next ones, after so many rounds of as many."""

    number: int
    count: int  # pictures of a segment, at least


Ask = Callable[[Round], Sequence[RoundSums]]  # measures a round of some groups


def measure_groups(m: Manifest, numbers: Sequence[int], views: ViewPlan, rounds: Rounds, ask: Ask) -> Measured:
    """Tables of some groups with PSNR, worst picture, SSIM and CIEDE2000 of every segment, level and key quality.

    PSNR is of the mean squared error, SSIM and CIEDE2000 are means. The reference is the original after repairs, in
    `rounds.count` pictures a segment, which `ask` measures; again and again in so many others, until the standard error
    of the top rung is at most UNSURE. Errors are heavy-tailed: a large Gaussian close to a view outweighs many others.

    Key qualities that are not the level's own are measured in one of OFF_LADDER of the pictures. Their squared errors
    are scaled by what the level's own error in all pictures is to its error in these (a ratio estimator; Cochran,
    Sampling Techniques, 1977, chapter 6), since a view that is hard for one rung is hard for all.
    """
    indices = [s for number in numbers for s in m.segments_of(number)]
    sums = {s: [[QualitySums() for _ in m.qualities] for _ in m.levels] for s in indices}
    for done in range(rounds.most):
        found = [of_segment for of_group in ask(Round(done, rounds.count)) for of_segment in of_group]
        for index, of_segment in zip(indices, found, strict=True):
            for mine, new in zip(itertools.chain(*sums[index]), itertools.chain(*of_segment), strict=True):
                mine.extend(new)
        if done + 1 >= rounds.least and _standard_error(m, sums) <= UNSURE:
            break
    turn = views.measured(rounds.count)
    groups = []
    for number in numbers:
        segments = [_with_sums(m, m.segments[s], sums[s], turn) for s in m.segments_of(number)]
        groups.append(replace(m.groups[number], segments=segments))
    return Measured(groups, (done + 1) * turn)


@dataclass(frozen=True, slots=True, eq=False)
class Measured:
    """Groups whose quality is known."""

    groups: list[Group]
    pictures: int  # of each segment that were measured

    def whole(self, m: Manifest) -> Manifest:
        """The tables of a package of which these are all groups."""
        return replace(m, groups=Groups.of(self.groups), views=replace(m.views, measured=self.pictures))


def measure_package(
    package: Package, sequence: GaussianSequence, views: ViewPlan, numbers: Sequence[int], rounds: Rounds
) -> Measured:
    """The quality of some groups of a package whose files are there; see `measure_groups`."""

    def ask(asked: Round) -> list[RoundSums]:
        return [measure_round(package, sequence, views, number, asked) for number in numbers]

    return measure_groups(package.manifest, numbers, views, rounds, ask)


def measure_round(package: Package, sequence: GaussianSequence, views: ViewPlan, group: int, asked: Round) -> RoundSums:
    """Render every rung of a group of a package beside the original, in the pictures of one round."""
    m, found = package.manifest, []
    bases = [decode_canonical(package, group, quality) for quality in range(len(m.qualities))]
    for index in m.segments_of(group):
        segment = m.segments[index]
        pictures = views.measure(asked.number * len(m.segments) + index, segment.start, segment.stop, asked.count)
        compared = _references(sequence, pictures, views.renderer)
        sums = [[QualitySums() for _ in m.qualities] for _ in m.levels]
        for j, level in enumerate(m.levels):
            for quality, base in enumerate(bases):
                looked_at = compared if quality == level.quality else compared[::OFF_LADDER]
                _measure(package, (index, j), base, looked_at, sums[j][quality], views.renderer)
        found.append(sums)
    return found


def _standard_error(m: Manifest, sums: Mapping[int, Sequence[Sequence[QualitySums]]]) -> float:
    """Relative standard error of the top rung's mean squared error, from the sums of segments; 0 without error."""
    frames = np.array([m.segments[s].stop - m.segments[s].start for s in sums])
    weights = frames / frames.sum()
    squared = [of[0][m.levels[0].quality].squared for of in sums.values()]
    mean = float(weights @ [np.mean(errors) for errors in squared])
    variance = float(weights**2 @ [np.var(errors) / max(1, len(errors) - 1) for errors in squared])
    return variance**0.5 / mean if mean else 0.0


def _with_sums(m: Manifest, segment: Segment, sums: Sequence[Sequence[QualitySums]], turn: int) -> Segment:
    """A segment with the quality that was measured, `turn` pictures at a time."""
    return replace(
        segment, levels=[_with_quality(m, j, sums[j], level, turn) for j, level in enumerate(segment.levels)]
    )


def _references(sequence: GaussianSequence, pictures: Pictures, renderer: Renderer) -> list[_Compared]:
    """The pictures with what the original shows in them."""
    numbers = sorted({number for number, _ in pictures})
    originals = dict(zip(numbers, sequence.load(numbers).frames, strict=True))
    draw = renderer.render
    return [(number, camera, Reference.of(draw(originals[number], camera).rgb)) for number, camera in pictures]


def _measure(
    package: Package,
    rung: tuple[int, int],
    base: Canonical,
    compared: Sequence[_Compared],
    sums: QualitySums,
    renderer: Renderer,
) -> None:
    """Add pictures of `rung`, a segment's level, over the canonical space that all units make in a key quality."""
    m, (index, level) = package.manifest, rung
    segment = m.segments[index]
    fewer = fewer_tiers(m.groups[m.group_of(index)], base, m.levels[level].tiers)
    places = sorted({number - segment.start for number, _, _ in compared})
    shown = dict(zip(places, decode_segment(package, index, fewer, level, places), strict=True))
    for number, camera, reference in compared:
        sums.add(renderer.render(shown[number - segment.start], camera).rgb, reference)


def _with_quality(m: Manifest, index: int, sums: Sequence[QualitySums], level: SegmentLevel, turn: int) -> SegmentLevel:
    """An entry of level `index` with its quality at each key quality, measured `turn` pictures at a time."""
    own = m.levels[index].quality
    whole = sums[own].squared
    shared = [error for place, error in enumerate(whole) if place % turn % OFF_LADDER == 0]
    scale = np.mean(whole) / np.mean(shared) if any(shared) else 1.0
    row = [of.quality(1.0 if q == own else float(scale)) for q, of in enumerate(sums)]
    return replace(
        level,
        psnr=[round(q.psnr, 2) for q in row],
        worst=[round(q.worst, 2) for q in row],
        ssim=[round(q.ssim, 4) for q in row],
        delta_e=[round(q.delta_e, 2) for q in row],
    )
