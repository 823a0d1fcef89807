"""Which pictures of a scene decide and measure, and what the deciding ones say about its groups before settings do.

Both kinds are drawn from the viewing region, with different seeds, so that no picture judges what it has decided. N
rows of a group after repairs.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from airgs_codec._sampling import evenly_spaced, middle_frames
from airgs_codec.analysis.importance import importance
from airgs_codec.analysis.region import DATAPARSER, SEEN, in_trained_frame, region_around, see, seeing
from airgs_codec.analysis.sensitivity import Sensitivity, measure_views
from airgs_codec.analysis.viewpoints import find_viewpoints
from airgs_codec.coding.atlas import UncodableError
from airgs_codec.encoder.settings import EncodeSettings
from airgs_codec.errors import ConfigError, SceneError
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
from airgs_codec.render.backend import CPU, Renderer, open_renderer
from airgs_codec.render.compare import View
from airgs_codec.scene.beside import Usage
from airgs_codec.scene.camera import cameras_from, resized, training_views
from airgs_codec.scene.gaussians import Gaussians
from airgs_codec.scene.sequence import GaussianSequence

CHECKED = 16  # further ones, which show what leaving out would do
DECISION_PIXELS = 200_000  # of a picture that decides: larger ones are made smaller
SMALL_PIXELS = 110_000  # of a picture, at most: of small ones twice as many decide
LOOKED_AT = 3  # frames, where no camera is given
DISTANCE = 3.0  # world units, from which scenes of scale 1 are mostly looked at
DRAWS = 240  # views that are drawn; groups and segments take them in turn

UNBOUNDED = ("means", "log_scales", "sh_dc", "sh_rest")  # attributes whose numbers may be of any size

Pictures = list[View]  # a frame is its place in its group, or its number in the sequence


@dataclass(frozen=True, slots=True, eq=False)
class ViewPlan:
    """Where a scene is looked at from while it is encoded."""

    region: Region
    trusted: bool  # what no view of the region shows may be left out
    deciding: Sequence[Camera]
    measuring: Sequence[Camera]
    decided: int  # pictures of a group that decide: the first of `deciding`
    notes: tuple[str, ...] = ()  # how the region was found, for people
    world: World | None = None  # which way is up, where it is told
    renderer: Renderer = CPU  # draws all pictures

    @staticmethod
    def of(
        sequence: GaussianSequence,
        pictures: int,
        *,
        margin: float | None = None,
        region: Region | None = None,
        world: World | None = None,
        renderer: Renderer = CPU,
    ) -> ViewPlan:
        """The region that is given, else the one about the scene's cameras, else about places that were found.

        `pictures` of each group decide, at least. Which way is up, `world` tells, else the format of the frames, else
        nobody. `renderer` draws all pictures.
        """
        axes, notes = sequence.axes, []
        if world is None and axes:
            world = world_from(axes.up, axes.metres)
            notes.append(f"{world_words(world)}; the specification of {sequence.format.name} says so")
        plan = _plan(sequence, pictures, margin, region, None if world is None else up_of(world), renderer)
        return replace(plan, world=world, renderer=renderer, notes=(*plan.notes, *notes))

    @property
    def scale(self) -> float:
        """How far away what is looked at mostly is, over what it is in scenes that default steps are made for."""
        places = ((np.array(place.position), np.array(place.focus)) for place in self.region.places)
        return float(np.median([np.linalg.norm(focus - position) for position, focus in places])) / DISTANCE

    def decide(self, frames: int) -> Pictures:
        """Pictures of a group of so many frames: all frames or evenly many of them, each from a view of its own."""
        return _spread(frames, self.deciding[: self.decided])

    def check(self, frames: int) -> Pictures:
        """Pictures of a group from other views, which show what leaving out would do.

        The views that rank rows make the errors of leaving out the lowest ones look smaller than they are.
        """
        return _spread(frames, self.deciding[self.decided : self.decided + CHECKED])

    def measure(self, index: int, start: int, stop: int, count: int) -> Pictures:
        """`count` pictures of segment number `index`, the frames [start, stop): (number of the frame, view).

        Views are the next ones after those of the segment before.
        """
        numbers = middle_frames(start, stop, count)
        rounds = -(-count // len(numbers))
        views = [self.measuring[turn % len(self.measuring)] for turn in range(index * count, (index + 1) * count)]
        return list(zip(sorted((numbers * rounds)[:count]), views, strict=True))


def plan_views(sequence: GaussianSequence, settings: EncodeSettings) -> ViewPlan:
    """The views that an encode with these settings takes. Raises ConfigError for a device that cannot be had."""
    return ViewPlan.of(
        sequence,
        settings.decide_pictures,
        margin=settings.margin,
        region=settings.region,
        world=settings.world and world_at(settings.world, sequence.origin),
        renderer=open_renderer(settings.device),
    )


def _plan(
    sequence: GaussianSequence,
    pictures: int,
    margin: float | None,
    region: Region | None,
    up: NDArray[np.float64] | None,
    renderer: Renderer,
) -> ViewPlan:
    """The plan without a world; `up` (3,), where it is told, matters to views that are found alone."""
    behind, middle = sequence.background, sequence.load([len(sequence) // 2]).frames[0]
    if region is not None:
        return _draw(region if region.background else with_background(region, behind), pictures, middle, renderer)
    cameras, notes = _given(sequence, middle, renderer)
    if cameras:
        held_out = [c for c in cameras if c.held_out]
        around = region_around(training_views(cameras), middle, margin=margin)
        plan = _draw(with_background(around, behind), pictures, middle, renderer, held_out)
        return replace(plan, notes=notes)
    found = find_viewpoints([sequence.read(i) for i in evenly_spaced(len(sequence), LOOKED_AT)], up)
    source, notes = "found" if found.confident else "orbit", (*notes, *filter(None, (found.story, found.guess)))
    around = region_around(found.cameras, middle, margin=margin, source=source)
    plan = _draw(with_background(around, behind), pictures, middle, renderer)
    return replace(plan, trusted=found.confident, notes=notes)


def _given(sequence: GaussianSequence, middle: Gaussians, renderer: Renderer) -> tuple[list[Camera], tuple[str, ...]]:
    """The cameras of a sequence that see something of it, none where they are of another scene, and what is to say."""
    if not sequence.cameras:
        return [], ()
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
        return [], (f"{what}: they are of another one, or in other coordinates, and are not used",)
    if sight.blind:
        notes.append(f"cameras that see nothing of the scene are not used: {', '.join(sight.blind)}")
    return sight.cameras, tuple(notes)


def _draw(
    region: Region, pictures: int, middle: Gaussians, renderer: Renderer, held_out: Sequence[Camera] = ()
) -> ViewPlan:
    """Draws from a region; where it has no extent, every draw is a place, and held-out cameras measure instead.

    Draws that show nothing of the middle frame are passed over. Raises ConfigError where all are, FormatError for a
    region that no reader would take.
    """
    check_written(region)
    point = all(place.reach == 0 for place in region.places) and region.turn == 0
    share = (DECISION_PIXELS / (region.width * region.height)) ** 0.5
    deciding, measuring = (seeing(draw_views(region, DRAWS, seed), middle, renderer) for seed in (DECIDING, MEASURING))
    if not (deciding and measuring):
        why = "places, sizes, opacities or colours of its Gaussians are beyond what pictures show"
        raise ConfigError(f"views: expected some that show the middle frame, got {2 * DRAWS} of nothing: {why}")
    measuring = list(held_out) if point and held_out else measuring
    small = region.width * region.height <= SMALL_PIXELS
    decided = 2 * pictures if small else pictures
    return ViewPlan(region, True, [resized(camera, share) for camera in deciding], measuring, decided)


def _spread(frames: int, cameras: Sequence[Camera]) -> Pictures:
    """Each camera with a frame, the frames evenly spaced and taking turns."""
    picked = evenly_spaced(frames, len(cameras))
    return list(zip(itertools.cycle(picked), cameras, strict=False))


@dataclass(frozen=True, slots=True)
class GroupSpan:
    """Frames [start, stop) that share a canonical space."""

    index: int  # of the group
    start: int
    stop: int

    @property
    def frames(self) -> int:
        return self.stop - self.start

    @property
    def middle(self) -> int:
        """Number of the frame in its middle."""
        return self.start + (self.stop - self.start) // 2


@contextmanager
def naming_farthest(sequence: GaussianSequence, span: GroupSpan) -> Iterator[None]:
    """Nothing; where the block finds a value of a group that no code holds, the error names the most extreme number."""
    try:
        yield
    except UncodableError as error:
        numbers = [_farthest(sequence, frame, name) for frame in range(span.start, span.stop) for name in UNBOUNDED]
        away, where = max(numbers)
        raise SceneError(f"{where} is {away:g} from the others: {error}") from error


def _farthest(sequence: GaussianSequence, frame: int, attribute: str) -> tuple[float, str]:
    """How far the number of an attribute that is farthest from the others is from them, and where it stands."""
    rows = getattr(replace(sequence, orders={}).read(frame), attribute).astype(np.float64)
    rows = np.where(np.isfinite(rows), rows, 0).reshape(len(rows), -1)
    away = np.abs(rows - np.median(rows, axis=0)).max(axis=1, initial=0)
    row = int(away.argmax())
    return float(away[row]), f"frame {frame} ({sequence.paths[frame].name}): {attribute} of row {row}"


@dataclass(frozen=True, slots=True, eq=False)
class Survey:
    """Findings of views of all frames about the rows of a group."""

    span: GroupSpan
    checks: Pictures  # other ones, which show what leaving out would do
    usage: Usage
    sensitivity: Sensitivity
    importance: NDArray[np.float64]  # (N,) of `analysis.importance`
    trusted: bool  # rows that no picture shows may be left out
    scale: float = 1.0  # of the scene, as in `ViewPlan`
    renderer: Renderer = CPU
    removals: dict[int, float] = field(default_factory=dict)  # errors in `checks` known so far, see `RowPruning`

    def score(self, name: str) -> NDArray[np.float64]:
        """(N,) one of `usage.MEASURES`: what ranks rows for key tiers."""
        return self.importance if name == "importance" else self.usage.measure(name)


def join_surveys(surveys: Sequence[Survey]) -> Survey:
    """The first of some surveys of groups that have the same rows, with the most that any says of each row."""

    def most(*columns: NDArray | None) -> NDArray | None:
        there = [column for column in columns if column is not None]
        return np.max(there, axis=0) if there else None

    def joined(parts: Sequence[Usage] | Sequence[Sensitivity]) -> dict[str, Any]:
        return {f.name: most(*(getattr(part, f.name) for part in parts)) for f in fields(parts[0])}

    usage, sensitivity = Usage(**joined([s.usage for s in surveys])), [s.sensitivity for s in surveys]
    ranked = np.max([s.importance for s in surveys], axis=0)
    parts = {"usage": usage, "sensitivity": Sensitivity(**joined(sensitivity)), "importance": ranked}
    return replace(surveys[0], **parts, removals={})


@dataclass(frozen=True, slots=True, eq=False)
class ShownPictures:
    """Pictures of a group with the Gaussians that they show, one at a time."""

    frames: Sequence[Gaussians]  # all of the group
    pictures: Pictures

    def __iter__(self) -> Iterator[tuple[Gaussians, Camera]]:
        return ((self.frames[place], camera) for place, camera in self.pictures)


def survey_group(sequence: GaussianSequence, span: GroupSpan, views: ViewPlan) -> Survey:
    """Survey one group over all of its frames; where the trainer's usage fits its rows, it takes precedence."""
    frames = sequence.load(range(span.start, span.stop)).frames
    pictures = sorted(views.decide(span.frames), key=lambda picture: picture[0])  # those of one frame share work
    usage, sensitivity = measure_views(ShownPictures(frames, pictures), views.renderer)
    known = sequence.usage(span.start, span.stop)
    if known is not None and len(known.peak) == len(frames[0]):
        usage = known
    ranked = importance(frames, usage, sensitivity)
    return Survey(
        span, views.check(span.frames), usage, sensitivity, ranked, views.trusted, views.scale, views.renderer
    )
