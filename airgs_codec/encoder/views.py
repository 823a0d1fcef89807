"""From where a scene is looked at while it is encoded: views that decide, and other ones that measure.

Both are drawn from the viewing region with different seeds, so that no picture judges what it has decided.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from airgs_codec._sampling import evenly_spaced
from airgs_codec.analysis.region import DATAPARSER, SEEN, in_trained_frame, region_around, see, seeing
from airgs_codec.analysis.up import SAME
from airgs_codec.analysis.viewpoints import find_viewpoints
from airgs_codec.encoder.settings import EncodeSettings
from airgs_codec.errors import ConfigError
from airgs_codec.package.parse import check_written
from airgs_codec.package.region import (
    DECIDING,
    MEASURING,
    draw_views,
    up_of,
    with_background,
    world_at,
    world_from,
    world_words,
)
from airgs_codec.package.tables import Region, World
from airgs_codec.render import Camera
from airgs_codec.render.backend import CPU, Renderer
from airgs_codec.render.compare import View
from airgs_codec.scene.camera import cameras_from, resized, training_views
from airgs_codec.scene.gaussians import Gaussians
from airgs_codec.scene.sequence import GaussianSequence

DECISION_PIXELS = 200_000  # of a picture that decides: larger ones are made smaller
SMALL_PIXELS = 110_000  # of pictures that are at most as large, twice as many decide
SEARCHED_FRAMES = 3  # frames, where no camera is given
DISTANCE = 3.0  # world units from which scenes of scale 1 are mostly looked at
DRAWS = 240  # views that are drawn of each kind

Pictures = list[View]  # the number of a frame in the sequence, and a camera


@dataclass(frozen=True)
class SceneViews:
    """The viewing region of a scene, and how many views of it decide."""

    region: Region
    world: World | None  # which way is up, where it is known
    trusted: bool  # Gaussians that no view of the region shows may be left out
    decided: int  # pictures that decide about a group
    checked: int  # other pictures, which show what leaving something out would do
    blind: tuple[tuple[int, ...], tuple[int, ...]] = ((), ())  # draws that show nothing: to decide, to measure

    @property
    def scale(self) -> float:
        """Return the median distance to what is looked at, as a multiple of DISTANCE, for which steps are made."""
        places = ((np.array(place.position), np.array(place.focus)) for place in self.region.places)
        return float(np.median([np.linalg.norm(focus - position) for position, focus in places])) / DISTANCE

    @cached_property
    def deciding(self) -> list[Camera]:
        share = (DECISION_PIXELS / (self.region.width * self.region.height)) ** 0.5
        return [resized(camera, share) for camera in self._drawn(DECIDING)]

    def measuring(self, sequence: GaussianSequence) -> list[Camera]:
        """Return the views that measure; of a region without extent the held-out cameras, if there are any."""
        point = self.region.turn == 0 and all(place.reach == 0 for place in self.region.places)
        held_out = [camera for camera in sequence.cameras if camera.held_out] if point else []
        return held_out or self._drawn(MEASURING)

    def decide(self, frames: range, groups: int = 1) -> Pictures:
        """Return pictures that decide about the frames of `groups` groups."""
        cameras = self.deciding[: self.decided] + self.deciding[self.decided + self.checked :]
        return _spread(frames, cameras[: round(self.decided * groups**0.5)])

    def check(self, frames: range) -> Pictures:
        """Return pictures from other views, which show what leaving something out would do.

        In the views that rank Gaussians, the errors of leaving out the lowest ones look smaller than they are.
        """
        return _spread(frames, self.deciding[self.decided : self.decided + self.checked])

    def _drawn(self, seed: int) -> list[Camera]:
        drawn = draw_views(self.region, DRAWS, seed)
        return [camera for number, camera in enumerate(drawn) if number not in self.blind[seed]]


def _spread(frames: range, cameras: Sequence[Camera]) -> Pictures:
    """Return each camera with one of evenly spaced frames, in their order."""
    picked = [frames[place] for place in evenly_spaced(len(frames), len(cameras))]
    return sorted(zip(itertools.cycle(picked), cameras, strict=False), key=lambda view: view[0])


def choose_views(
    sequence: GaussianSequence, settings: EncodeSettings, renderer: Renderer = CPU
) -> tuple[SceneViews, tuple[str, ...]]:
    """Choose the region that is given, else the one about the scene's cameras, else about places that were found.

    Also gives sentences on how it was found. Which way is up, the settings say, else the format of the frames, unless a
    scene without cameras surely stands otherwise, else nobody does. Raises ConfigError where nothing is seen from the
    region, FormatError for one that no reader takes.
    """
    world, notes = settings.world and world_at(settings.world, sequence.origin), list[str]()
    told, axes = None if world is None else up_of(world), None if world else sequence.axes
    if axes:
        world = world_from(axes.up, axes.metres)
        notes.append(f"{world_words(world)}; the specification of {sequence.format.name} says so")
    middle, region, trusted = sequence.load([len(sequence) // 2]).frames[0], settings.region, True
    if region is None:
        cameras, of_cameras = _cameras_of(sequence, middle, renderer)
        if cameras:
            region = region_around(training_views(cameras), middle, margin=settings.margin)
            notes = [*of_cameras, *notes]
        else:
            looked = [sequence.read(i) for i in evenly_spaced(len(sequence), SEARCHED_FRAMES)]
            found = find_viewpoints(looked, told, axes, sequence.paths[0].suffix or "splat")
            if axes and found.up @ axes.up < SAME:
                world, notes = None, []
            trusted, source = found.confident, "found" if found.confident else "orbit"
            region = region_around(found.cameras, middle, margin=settings.margin, source=source)
            notes = [*of_cameras, *filter(None, (found.summary, found.guess)), *notes]
    if not region.background:
        region = with_background(region, sequence.background)
    check_written(region)
    blind = tuple(_blind(region, seed, middle, renderer) for seed in (DECIDING, MEASURING))
    if any(len(some) == DRAWS for some in blind):
        why = "places, sizes, opacities or colours of its Gaussians are beyond what pictures show"
        raise ConfigError(f"views: expected some that show the middle frame, got {2 * DRAWS} of nothing: {why}")
    small = region.width * region.height <= SMALL_PIXELS
    decided = settings.decide_pictures * (2 if small else 1)
    chosen = SceneViews(region, world, trusted, decided, settings.check_pictures, (blind[0], blind[1]))
    return chosen, tuple(notes)


def _blind(region: Region, seed: int, frame: Gaussians, renderer: Renderer) -> tuple[int, ...]:
    drawn = draw_views(region, DRAWS, seed)
    seen = {id(camera) for camera in seeing(drawn, frame, renderer)}
    return tuple(number for number, camera in enumerate(drawn) if id(camera) not in seen)


def _cameras_of(sequence: GaussianSequence, middle: Gaussians, renderer: Renderer) -> tuple[list[Camera], list[str]]:
    """Return the cameras of a sequence that see something of it, and notes; none where they are of another scene."""
    if not sequence.cameras:
        return [], []
    path, notes = sequence.cameras_path, []
    sight = see(sequence.cameras, middle, renderer)
    for moves in {place / DATAPARSER for place in (sequence.folder, path.parent if path else sequence.folder)}:
        if not moves.is_file():
            continue
        trained = in_trained_frame(cameras_from(np.negative(sequence.origin), sequence.cameras), moves)
        other = see(cameras_from(sequence.origin, trained), middle, renderer)
        if other.share > sight.share:
            sight = other
            notes.append(f"cameras are moved to where the Gaussians are, as {moves.name} says")
    if sight.share < SEEN:
        what = f"{len(sequence.cameras)} cameras{f' of {path.name}' if path else ''} see {sight.share:.1%} of the scene"
        return [], [f"{what}: they are of another one, or in other coordinates, and are not used"]
    if sight.blind:
        notes.append(f"cameras that see nothing of the scene are not used: {', '.join(sight.blind)}")
    return sight.cameras, notes
