"""Which pictures of a scene decisions are made with, and which ones measure what came of them.

Both are drawn from the viewing region, with different seeds, so that no picture judges what it has decided.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

from airgs_codec._sampling import evenly_spaced, middle_frames
from airgs_codec.analysis.region import region_around
from airgs_codec.package.region import draw_views
from airgs_codec.package.tables import Region, Views
from airgs_codec.render import Camera
from airgs_codec.scene.camera import resized, training_views
from airgs_codec.scene.orbits import orbit_views
from airgs_codec.scene.sequence import GaussianSequence

DECIDING, MEASURING = 0, 1  # seeds of the draws
DECIDED = 24  # pictures of a group that decide
DECISION_PIXELS = 200_000  # of a picture that decides: larger ones are made smaller
DRAWS = 240  # views that are drawn; groups and segments take them in turn

Pictures = list[tuple[int, Camera]]  # (place of a frame in its group, or its number in the sequence; view)


@dataclass(frozen=True, slots=True, eq=False)
class ViewPlan:
    """Where a scene is looked at from while it is encoded."""

    region: Region
    trusted: bool  # what no view of the region shows may be left out
    deciding: Sequence[Camera]
    measuring: Sequence[Camera]
    notes: tuple[str, ...] = ()  # how the region was found, for people

    @staticmethod
    def of(sequence: GaussianSequence, *, margin: float | None = None, region: Region | None = None) -> ViewPlan:
        """The region that is given, else the one about the scene's cameras, else about places that were found."""
        middle = sequence.load([len(sequence) // 2]).frames[0]
        if region is not None:
            return ViewPlan._drawn(region, True)
        if sequence.cameras:
            held_out = [c for c in sequence.cameras if c.held_out]
            around = region_around(training_views(sequence.cameras), middle, margin=margin)
            return ViewPlan._drawn(around, True, held_out)
        cameras = orbit_views(middle)
        return ViewPlan._drawn(region_around(cameras, middle, margin=margin, source="orbit"), False)

    @staticmethod
    def _drawn(region: Region, trusted: bool, held_out: Sequence[Camera] = ()) -> ViewPlan:
        """Draws from a region; where it has no extent, every draw is a place, and held-out cameras measure instead."""
        deciding = draw_views(region, DRAWS, DECIDING)
        point = all(place.reach == 0 for place in region.places) and region.turn == 0
        measuring = list(held_out) if point and held_out else draw_views(region, DRAWS, MEASURING)
        share = (DECISION_PIXELS / (region.width * region.height)) ** 0.5
        return ViewPlan(region, trusted, [resized(camera, share) for camera in deciding], measuring)

    def decide(self, frames: int) -> Pictures:
        """Pictures of a group of so many frames: all frames or evenly many of them, each from views of its own."""
        picked = evenly_spaced(frames, DECIDED)
        rounds = -(-DECIDED // len(picked))
        return list(zip(picked * rounds, itertools.cycle(self.deciding), strict=False))[: max(DECIDED, len(picked))]

    def measure(self, index: int, start: int, stop: int, count: int) -> Pictures:
        """`count` pictures of segment number `index`, the frames [start, stop): (number of the frame, view)."""
        numbers = middle_frames(start, stop, count)
        rounds = -(-count // len(numbers))
        first = index * count % len(self.measuring)
        views = itertools.islice(itertools.cycle(self.measuring), first, first + count)
        return list(zip(sorted((numbers * rounds)[:count]), views, strict=True))

    def table(self, measured: int) -> Views:
        """The record in airgs.json; `measured` pictures of each segment, 0 for none."""
        return Views(DECIDED, measured, "original" if measured else "none")
