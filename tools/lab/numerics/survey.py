"""How far a claimed PSNR is off, against the seconds of looking.

A claim is the PSNR of the top rung in a fixed number of pictures, views and frames drawn anew for every trial. The
truth is that of many other views in all frames.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import cycle, islice, product

import numpy as np

from airgs_codec.encoder.views import Pictures
from airgs_codec.media.metrics import psnr
from airgs_codec.package.package import Package
from airgs_codec.package.region import draw_views
from airgs_codec.scene.gaussians import Gaussians
from tools.lab import seconds_of
from tools.lab.numerics.encode import ONE_RUNG
from tools.lab.numerics.rows import Bench, Place, Point, Row, Scene, picture_error, shown_frames

TRUE_VIEWS, TRUE_SEED, TRIAL_SEED = 48, 1000, 2000
COUNTS = (1, 2, 4, 8, 16, 32)  # pictures
APART, ONE_VIEW, ONE_FRAME = "own views", "one view", "one frame"
OFF = "dB that the claim is off"


@dataclass(frozen=True, eq=False)
class Subject:
    scene: Scene
    package: Package
    views: int  # that tell the truth

    @cached_property
    def frames(self) -> list[tuple[Gaussians, Gaussians]]:
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
    for scene in bench.scenes:
        subject = Subject(scene, bench.package(scene, ONE_RUNG, "one-rung"), 4 if bench.quick else TRUE_VIEWS)
        counts = (1, 4, 16) if bench.quick else COUNTS
        for curve, count in product((APART, ONE_VIEW, ONE_FRAME), counts):
            if curve == ONE_VIEW and count > len(scene.sequence):
                continue
            place = Place("claims", scene.name, curve, str(count))
            reads = {"place": place, "trials": bench.repeats, "views": subject.views}
            yield Point("claim", scene, reads, partial(claim, subject, place, bench.repeats))


def claim(subject: Subject, place: Place, trials: int) -> list[Row]:
    """Return what claims from so many pictures are off, and what looking takes."""
    pictures = draws(subject, place.curve, int(place.setting), trials)
    looked = [seconds_of(partial(subject.psnr, some)) for some in pictures]
    return [Row.of(place, [s for s, _ in looked], [abs(q - subject.truth) for _, q in looked], OFF)]


def draws(subject: Subject, curve: str, count: int, trials: int) -> Iterator[Pictures]:
    region, frames = subject.package.manifest.region, len(subject.frames)
    for seed in range(TRIAL_SEED, TRIAL_SEED + trials):
        numbers = [int(n) for n in np.random.default_rng(seed).permutation(frames)]
        cameras = draw_views(region, 1 if curve == ONE_VIEW else count, seed)
        some = numbers[:1] if curve == ONE_FRAME else numbers
        yield list(islice(zip(cycle(some), cycle(cameras)), count))
