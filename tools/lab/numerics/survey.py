"""How far a claimed PSNR is off, against the seconds of looking, and what more pictures that decide are worth.

A claim is the PSNR of the top rung in some pictures, views and frames drawn anew for every trial. The truth is that of
many other views in all frames.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import cycle, islice

import numpy as np

from airgs_codec.encoder.measure import Round, RoundErrors, Rounds, measure_groups, measure_round, pictures_of
from airgs_codec.encoder.survey import GroupSpan, Pictures, plan_views, survey_group
from airgs_codec.media.metrics import psnr
from airgs_codec.package.manifest import pooled_quality
from airgs_codec.package.package import Package
from airgs_codec.package.region import draw_views
from airgs_codec.scene.gaussians import Gaussians
from tools.lab.numerics.encode import ONE_RUNG, UNIT, at_target
from tools.lab.numerics.rows import Bench, Place, Point, Row, Scene, picture_error, shown_frames
from tools.lab.timing import seconds_of, timed

TRUE_VIEWS, TRUE_SEED, TRIAL_SEED = 48, 1000, 2000
COUNTS = (1, 2, 4, 8, 16, 32)  # pictures
APART, ONE_VIEW, ONE_FRAME = "own views", "one view", "one frame"
OWN = "the encoder"
MEASURED = (1, 2, 5, 10, 20)  # --measure-pictures
DECIDING = (2, 6, 24, 48)  # --decide-pictures
OFF = "dB that the claim is off"


@dataclass(frozen=True, eq=False)
class Subject:
    """A package beside its scene."""

    scene: Scene
    package: Package
    views: int  # that tell the truth

    @cached_property
    def frames(self) -> list[tuple[Gaussians, Gaussians]]:
        """Every frame as it is shown and as it was."""
        numbers = range(self.package.manifest.frames)
        shown = shown_frames(self.package, numbers)
        return [(shown[n], self.scene.sequence.load([n]).frames[0]) for n in numbers]

    @cached_property
    def truth(self) -> float:
        """PSNR in dB of every frame in many views."""
        cameras = draw_views(self.package.manifest.region, self.views, TRUE_SEED)
        return self.psnr([(n, camera) for n in range(len(self.frames)) for camera in cameras])

    def psnr(self, pictures: Pictures) -> float:
        """PSNR in dB of the pooled error of some pictures."""
        return psnr(float(np.mean([picture_error(*self.frames[n], camera) for n, camera in pictures])))


def measure(bench: Bench) -> Iterator[Point]:
    """Claims by how many pictures, of which views and frames; then what deciding pictures are worth."""
    for scene in bench.scenes:
        package = bench.package(scene, ONE_RUNG, "one-rung")
        yield from claims(bench, Subject(scene, package, 4 if bench.quick else TRUE_VIEWS))
    yield from deciding(bench, bench.scenes[0])


def claims(bench: Bench, subject: Subject) -> Iterator[Point]:
    """|claimed - true| over seconds, for ways to spend so many pictures."""
    trials = 3 if bench.quick else 8
    counts = (1, 4, 16) if bench.quick else COUNTS
    for curve in (APART, ONE_VIEW, ONE_FRAME):
        for count in counts:
            if curve == ONE_VIEW and count > len(subject.scene.sequence):
                continue
            place = Place("survey", "claims", subject.scene.name, curve, str(count))
            reads = {"place": place, "trials": trials, "views": subject.views}
            yield Point("claim", subject.scene, reads, partial(claim, subject, place, trials))
    for count in (2, 10) if bench.quick else MEASURED:
        place = Place("survey", "claims", subject.scene.name, OWN, str(count))
        yield Point("own claim", subject.scene, {"place": place, "views": subject.views}, partial(own, subject, place))


def claim(subject: Subject, place: Place, trials: int) -> list[Row]:
    """Return what claims from so many pictures are off, and what looking takes."""
    pictures = draws(subject, place.curve, int(place.setting), trials)
    looked = [seconds_of(partial(subject.psnr, some)) for some in pictures]
    return [Row.of(place, [s for s, _ in looked], [abs(q - subject.truth) for _, q in looked], OFF)]


def draws(subject: Subject, curve: str, count: int, trials: int) -> Iterator[Pictures]:
    """The pictures of each trial."""
    region, frames = subject.package.manifest.region, len(subject.frames)
    for seed in range(TRIAL_SEED, TRIAL_SEED + trials):
        numbers = [int(n) for n in np.random.default_rng(seed).permutation(frames)]
        cameras = draw_views(region, 1 if curve == ONE_VIEW else count, seed)
        some = numbers[:1] if curve == ONE_FRAME else numbers
        yield list(islice(zip(cycle(some), cycle(cameras)), count))


def own(subject: Subject, place: Place) -> list[Row]:
    """Return what the encoder claims with so many `--measure-pictures`; it also measures SSIM and CIEDE2000."""
    views = plan_views(subject.scene.sequence, ONE_RUNG)
    package, groups = subject.package, range(len(subject.package.manifest.groups))
    rounds = Rounds(int(place.setting))

    def ask(asked: Round) -> list[RoundErrors]:
        m = package.manifest
        drawn = [pictures_of(views, m, group, asked, len(m.segments)) for group in groups]
        return [
            measure_round(package, subject.scene.sequence, views.renderer, group, pictures)
            for group, pictures in zip(groups, drawn, strict=True)
        ]

    seconds, measured = seconds_of(lambda: measure_groups(package.manifest, groups, views, rounds, ask))
    quality = pooled_quality(measured.whole(package.manifest), 0, 0)
    assert quality is not None
    return [Row.of(place, [seconds], [abs(quality.psnr - subject.truth)], OFF)]


def deciding(bench: Bench, scene: Scene) -> Iterator[Point]:
    """Bytes of a frame at 43 dB over the seconds of the survey, with more and more pictures that decide."""
    for count in (2, 24) if bench.quick else DECIDING:
        place = Place("survey", "deciding", scene.name, "calibrated", str(count))
        repeats = 1 if bench.quick else 3
        yield Point("deciding", scene, {"place": place, "repeats": repeats}, partial(decided, bench, place, repeats))


def decided(bench: Bench, place: Place, repeats: int) -> list[Row]:
    """Bytes at the target with so many deciding pictures, and what the survey takes."""
    scene = bench.scenes[0]
    settings = replace(ONE_RUNG, calibrate="steps", decide_pictures=int(place.setting))
    size, _ = at_target(scene.sequence, settings, 1)
    views, package = plan_views(scene.sequence, settings), bench.package(scene, ONE_RUNG, "one-rung")
    spans = [GroupSpan(i, group.start, group.stop) for i, group in enumerate(package.manifest.groups)]
    took = timed(lambda: [survey_group(scene.sequence, span, views) for span in spans], repeats)
    return [Row.of(place, took, [size / 1e3], UNIT, size)]
