"""The pictures of a multi-view scene as they are trained on, and plates: what a camera sees where nothing moves.

Pictures are undistorted, shrunk, masked and exposed alike. They are read when they are asked for and buffered in 8 bits
at training size; targets in float32 are made of them when they are needed. Of both, those used last are buffered, so
that memory is bounded however many pictures there are.

The plate of a camera that stands still is taken from a few frames of the whole run, so that it is the same however
often a run is resumed, and its noise is less than that of a picture. A pixel rests where the picture differs from the
plate by less than the camera's noise. Nothing is carried from frame to frame: what drifts away slowly leaves its plate
in the end, too.

H x W pixels, n = 3 W interleaved samples a row.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import partial
from operator import attrgetter
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from airgs_codec.errors import SceneError
from airgs_codec.media.image import box_mean, check_picture, read_mask, resize, to_bytes, to_floats, undistort
from airgs_codec.render.cpu import Redraw
from airgs_codec.scene.camera import Background, Camera, with_pixels
from airgs_codec.trainer.data.multiview import MultiviewScene, Shot
from airgs_codec.trainer.settings import OFF, RANDOM, TrainSettings, named_background

PICTURE_BYTES = 1 << 30  # of pictures in 8 bits: 40 in 4K, or 170 in 1080p
TARGET_BYTES = 2 << 30  # of targets: 7 in 4K, or 28 in 1080p


Key = TypeVar("Key", bound=Hashable)
Value = TypeVar("Value")


class Recent(Generic[Key, Value]):
    """Values that are made when they are asked for, of which those used last stay in memory."""

    def __init__(
        self, make: Callable[[Key], Value], most: int, size_of: Callable[[Value], int] = attrgetter("nbytes")
    ) -> None:
        """`most`: bytes that stay together; the value that was asked for last stays whatever it takes."""
        self._make, self._most, self._size_of = make, most, size_of
        self._values: OrderedDict[Key, Value] = OrderedDict()

    @property
    def nbytes(self) -> int:
        return sum(map(self._size_of, self._values.values()))

    def get(self, key: Key) -> Value:
        if key not in self._values:
            return self.put(key, self._make(key))
        self._values.move_to_end(key)
        return self._values[key]

    def put(self, key: Key, value: Value) -> Value:
        self._values[key] = value
        while len(self._values) > 1 and self.nbytes > self._most:
            self._values.popitem(last=False)
        return value


Exposure = Mapping[str, Sequence[float]]  # camera -> gains r, g, b and offsets r, g, b


class Target:
    def __init__(self, rgb: NDArray[np.float32], clear: NDArray[np.float32] | None = None) -> None:
        """`rgb`: (H, W, 3), 0..1. `clear`: (H, W) share of the background in it; None: not known."""
        self.rgb = np.ascontiguousarray(rgb, np.float32)
        self.clear = clear
        self.moments: tuple[NDArray[np.float32], NDArray[np.float32]] | None = None  # (H, n), by `fit.losses.moments`
        self.on_device: Any = None  # a tensor of `rgb`, where the loss is computed on a device

    @property
    def rows(self) -> NDArray[np.float32]:
        return self.rgb.reshape(len(self.rgb), -1)

    @property
    def nbytes(self) -> int:
        return 3 * self.rgb.nbytes + (0 if self.clear is None else self.clear.nbytes)


@dataclass(frozen=True, slots=True, eq=False)
class View:
    camera: Camera
    picture: Target | Callable[[], Target]  # it, or what reads it
    redraw: Redraw | None = None  # None: the whole picture is drawn
    after: float = 0.0  # as in `Shot`

    @property
    def target(self) -> Target:
        """The picture; hold it no longer than it is needed. Raises SceneError where it cannot be read."""
        return self.picture if isinstance(self.picture, Target) else self.picture()

    def before(self, background: Background) -> View:
        """The same before another background. Raises ValueError where the picture has no alpha."""
        shown = self.target
        if shown.clear is None:
            raise ValueError("expected a picture whose background is known")
        change = np.subtract(background, self.camera.background).astype(np.float32)
        target = Target(shown.rgb + shown.clear[..., None] * change, shown.clear)
        return View(replace(self.camera, background=background), target, after=self.after)


@dataclass(frozen=True, slots=True, eq=False)
class Plate:
    rgb: NDArray[np.uint8]  # (H, W, 3)
    noise: float  # standard deviation of a pixel, 0..1
    tolerance: float  # of the mean over WINDOW x WINDOW pixels, 0..1


Plates = Mapping[str, Plate]  # by the name of the camera


class Masks(Sequence[NDArray[np.bool_]]):
    """Masks (H, W), a bit a pixel."""

    def __init__(self, masks: Iterable[NDArray[np.bool_]]) -> None:
        self._packed = [(mask.shape, np.packbits(mask)) for mask in masks]

    def __len__(self) -> int:
        return len(self._packed)

    def __getitem__(self, index: Any) -> Any:
        shape, bits = self._packed[index]
        return np.unpackbits(bits, count=shape[0] * shape[1]).reshape(shape).astype(np.bool_)


@dataclass(frozen=True, slots=True, eq=False)
class FrameViews:
    """A frame and the views that it is fitted to."""

    frame: int
    views: Sequence[View]
    moving: Sequence[NDArray[np.bool_]] | None = None  # (H, W) of each view, what does not rest now or in the frame
    # before; None: not known, anything may move
    later: Sequence[View] = ()  # of the frame behind, which a first frame is fitted to as well


class Pictures:
    """The pictures of a scene at training size, exposed alike, and at rest as their plates are."""

    def __init__(
        self,
        scene: MultiviewScene,
        *,
        max_size: int | None = None,
        foreground: bool = False,
        background: str | None = None,
        picture_bytes: int = PICTURE_BYTES,
        target_bytes: int = TARGET_BYTES,
    ) -> None:
        """Read nothing yet.

        `max_size`: longest side in pixels; None: as they are. `foreground`: what the masks leave out becomes
        background. `background`: as in `TrainSettings`; pictures and cameras have the one of the scene unless it names
        a colour, and with RANDOM pictures must have alpha. `picture_bytes`, `target_bytes`: most memory that pictures
        in 8 bits and targets may hold; one of each is buffered whatever it takes.
        """
        self._scene = scene
        self._max_size = max_size
        self._foreground = foreground
        self._random = background == RANDOM
        self.background = named_background(background) or scene.background
        self.exposure: Exposure = {}
        self.plates: Plates = {}  # of every training camera; none: nothing is known to rest
        self._moving: dict[int, Masks] = {}  # of the last frame that was a target
        self._target_bytes = target_bytes
        self._stored = Recent(self._load, picture_bytes)
        self._targets = Recent(self._make_target, target_bytes)

    def with_exposure(self, exposure: Exposure) -> Pictures:
        """The same pictures as the average camera would have exposed them; those buffered in 8 bits are shared."""
        other = copy(self)
        other.exposure, other._moving = dict(exposure), {}
        other._targets = Recent(other._make_target, self._target_bytes)
        return other

    def with_plates(self, plates: Sequence[Plate]) -> Pictures:
        """The same that know what rests; `plates`: of every training camera, or none at all."""
        other, names = copy(self), [camera.name for camera in self._scene.cameras if not camera.held_out]
        other.plates, other._moving = dict(zip(names, plates, strict=True)) if plates else {}, {}
        return other

    @property
    def nbytes(self) -> int:
        return self._stored.nbytes + self._targets.nbytes

    def train(self, frame: int) -> list[View]:
        return self._split(frame, held_out=False)

    def held_out(self, frame: int) -> list[View]:
        return self._split(frame, held_out=True)

    def first(self) -> FrameViews:
        """The first frame of a run as it is fitted: cameras that saw it before its time saw it after that, too."""
        target = FrameViews(0, self.at_rest(0)[0])
        return replace(target, later=self._behind(target).views)

    def target(self, frame: int, start: int) -> FrameViews:
        """A frame as it is fitted from the Gaussians of the frame `start`."""
        views, now = self.at_rest(frame)
        if now is None:
            return FrameViews(frame, views)
        before, seen = self._moving.get(start), self.train(start)
        if before is None:  # pictures of a frame that is past may be out of memory
            before = find_moving(seen, self.plates, self.exposure)
        self._moving = {frame: now}
        places = _places(seen)  # a camera without a picture of the frame before tells what moves now alone
        pairs = ((mask, places.get(view.camera.name)) for mask, view in zip(now, views, strict=True))
        return FrameViews(frame, views, Masks(mask if i is None else mask | before[i] for mask, i in pairs))

    def key(self, target: FrameViews) -> FrameViews:
        """The same frame as it is fitted where a group begins: what was seen before its time may not show it at all.

        Cameras that were early show what they saw next, where that is known.
        """
        in_time, behind = [i for i, view in enumerate(target.views) if view.after >= 0], self._behind(target)
        if len(in_time) == len(target.views) or not (in_time or behind.views):
            return target
        views, moving = [*(target.views[i] for i in in_time), *behind.views], None
        if target.moving is not None and behind.moving is not None:
            moving = Masks([*(target.moving[i] for i in in_time), *behind.moving])
        return replace(target, views=views, moving=moving)

    def _behind(self, target: FrameViews) -> FrameViews:
        """What cameras that were early saw next; no views where the frame behind a frame is not known."""
        early, frame = [i for i, view in enumerate(target.views) if view.after < 0], target.frame + 1
        if not early or not any(self._scene.frames[frame : frame + 1]):
            return FrameViews(target.frame, [], Masks([]))
        seen, now = self.at_rest(frame)
        places, moving = _places(seen), None
        pairs = [(i, places[name]) for i in early if (name := target.views[i].camera.name) in places]
        if now is not None:
            moving = Masks((target.moving[i] | now[j]) if target.moving else now[j] for i, j in pairs)
        return FrameViews(target.frame, [replace(seen[j], after=seen[j].after + 1) for _, j in pairs], moving)

    def at_rest(self, frame: int) -> tuple[list[View], Masks | None]:
        """The training views of a frame as their plates have them where they rest, and where they do not."""
        views = self.train(frame)
        return settle(views, self.plates, self.exposure) if self.plates else (views, None)

    def _split(self, frame: int, held_out: bool) -> list[View]:
        shots = self._scene.frames[frame]
        return [self.view(frame, i) for i, s in enumerate(shots) if s.camera.held_out == held_out]

    def view(self, frame: int, index: int) -> View:
        shot = self._scene.frames[frame][index]
        return View(self._scaled(shot.camera), partial(self._targets.get, (frame, index)), after=shot.after)

    def seen_by(self, camera: int, frame: int) -> View | None:
        """The view of a camera, counted as those of frame 0; None: it has no picture of the frame."""
        place = self._scene.place(frame, camera)
        return None if place is None else self.view(frame, place)

    def cameras(self) -> list[Camera]:
        return [self._scaled(camera) for camera in self._scene.cameras]

    def check(self) -> None:
        """Read the training pictures of frame 0, and all headers. Raises SceneError for what cannot be used."""
        for frame, shots in enumerate(self._scene.frames):
            for index, shot in enumerate(shots):
                if frame == 0 and not shot.camera.held_out:
                    self._stored.get((frame, index))
                else:
                    shot.source.check(shot.size)
                    self._check_mask(shot)

    def _scaled(self, camera: Camera) -> Camera:
        camera = replace(camera, background=self.background)
        longest = max(camera.width, camera.height)
        if self._max_size is None or longest <= self._max_size:
            return camera
        factor = self._max_size / longest
        return with_pixels(camera, max(1, round(camera.width * factor)), max(1, round(camera.height * factor)))

    def _make_target(self, key: tuple[int, int]) -> Target:
        stored, shot = self._stored.get(key), self._scene.frames[key[0]][key[1]]
        rgb = exposed_alike(to_floats(stored[..., :3]), self.exposure.get(shot.camera.name))
        return Target(rgb, to_floats(stored[..., 3]) if stored.shape[2] == 4 else None)

    def _load(self, key: tuple[int, int]) -> NDArray[np.uint8]:
        """(H, W, 3) before the background of the scene, with alpha or a mask (H, W, 4) with its share of each pixel."""
        shot = self._scene.frames[key[0]][key[1]]
        camera, data = self._scaled(shot.camera), shot.source.read(shot.size)
        self._check_mask(shot)
        mask = read_mask(shot.mask, shot.size) if self._foreground and shot.mask else None
        if mask is None and data.shape[2] == 3:
            if self._random:
                raise SceneError(f"{shot.source}: expected alpha for random backgrounds, got an opaque picture")
            if shot.lens is None and shot.size == (camera.width, camera.height):
                return np.ascontiguousarray(data)
            whole = to_floats(data)
        else:
            values = to_floats(data)
            rgb, alpha = values[..., :3], values[..., 3] if data.shape[2] == 4 else np.ones(data.shape[:2], np.float32)
            clear = 1 - (alpha if mask is None else alpha * mask)[..., None]
            whole = np.concatenate([(1 - clear) * rgb + clear * np.array(self.background, np.float32), clear], axis=2)
        if shot.lens:
            whole = undistort(whole, shot.lens)
        return to_bytes(resize(whole, camera.width, camera.height))

    def _check_mask(self, shot: Shot) -> None:
        if self._foreground:
            if shot.mask is None:
                raise SceneError(f"{shot.source}: expected a mask of the foreground, the scene has none")
            check_picture(shot.mask, shot.size)


def _places(views: Sequence[View]) -> dict[str, int]:
    return {view.camera.name: place for place, view in enumerate(views)}


def pictures_for(scene: MultiviewScene, settings: TrainSettings) -> Pictures:
    masked = settings.foreground != OFF
    return Pictures(scene, max_size=settings.max_size, foreground=masked, background=settings.background)


def exposed_alike(picture: NDArray[np.float32], values: Sequence[float] | None) -> NDArray[np.float32]:
    """The picture (H, W, 3) as the average camera would have exposed it; `values`: as in `Exposure`."""
    if values is None:
        return picture
    gains, offsets = np.array(values, np.float32).reshape(2, 3)
    return (picture - offsets) / gains


FEWEST = 3  # frames of a run that has plates
SAMPLES = 16  # most frames that a plate is the median of
WINDOW = 5  # pixels that differences are averaged over: noise goes, a shadow's edge stays
LEAST, MOST = 3 / 255, 5 / 255  # bounds of the tolerance: more than that moves, however noisy a camera is
DEVIATIONS = 8.0 / WINDOW  # of a pixel's noise: four of the mean's, were it white, and twice that for what codecs leave
MEDIAN = 0.6745  # of the absolute value of a normal variable
HALO = 5  # pixels across: what moves, and what the Gaussians that make it reach


def stands_still(scene: MultiviewScene) -> bool:
    """Whether every camera is one of those of frame 0 and as it was there; pictures may be missing."""
    first = {camera.name: _pose(camera) for camera in scene.cameras}
    return len(first) == len(scene.cameras) and all(
        len({shot.camera.name for shot in shots}) == len(shots)
        and all(first.get(shot.camera.name) == _pose(shot.camera) for shot in shots)
        for shots in scene.frames
    )


def _pose(camera: Camera) -> tuple[Any, ...]:
    place = camera.world_to_camera.tolist()
    return place, camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy


def plate_sources(scene: MultiviewScene) -> list[tuple[int, list[int]]]:
    """The training cameras that plates are taken from, as numbers, and the frames of each; none of a rig that moves."""
    if len(scene) < FEWEST or not stands_still(scene):
        return []
    frames: list[int] = np.unique(np.linspace(0, len(scene) - 1, SAMPLES).round().astype(int)).tolist()
    return [(i, frames) for i, camera in enumerate(scene.cameras) if not camera.held_out]


def find_plate(pictures: Pictures, camera: int, frames: Sequence[int]) -> Plate:
    """The plate of one camera, from its pictures as it exposed them. Raises SceneError for one that cannot be read."""
    views = [pictures.seen_by(camera, frame) for frame in frames]
    return plate_of([to_bytes(view.target.rgb) for view in views if view])


def plate_of(pictures: Sequence[NDArray[np.uint8]]) -> Plate:
    """The plate of a camera that took these pictures (H, W, 3): their lower median, which is a value that was seen."""
    middle = (len(pictures) - 1) // 2
    rgb = np.empty_like(pictures[0])
    for y in range(len(rgb)):  # row by row: a median of all at once takes a copy of all
        rgb[y] = np.partition(np.stack([picture[y] for picture in pictures]), middle, axis=0)[middle]
    noise = float(np.median([_noise(to_floats(picture) - to_floats(rgb)) for picture in pictures]))
    return Plate(rgb, noise, float(np.clip(DEVIATIONS * noise, LEAST, MOST)))


def _noise(difference: NDArray[np.float32]) -> float:
    return float(np.median(np.abs(difference - box_mean(difference, WINDOW)))) / MEDIAN


def settle(views: Sequence[View], plates: Plates, exposure: Exposure) -> tuple[list[View], Masks]:
    """Views as their plates have them where they rest, and where they do not (`find_moving`)."""

    def flatten(place: int) -> Target:
        target, rgb = views[place].target, _rest_of(views[place], plates, exposure)
        return Target(np.where(masks[place][..., None], target.rgb, rgb), target.clear)

    masks = find_moving(views, plates, exposure)
    buffer = Recent(flatten, TARGET_BYTES)
    return [replace(view, picture=partial(buffer.get, place)) for place, view in enumerate(views)], masks


def find_moving(views: Sequence[View], plates: Plates, exposure: Exposure) -> Masks:
    """The pixels of views that do not rest, and those right around them; `exposure`: of their pictures."""
    return Masks(_moving(v.target.rgb - _rest_of(v, plates, exposure), plates[v.camera.name]) for v in views)


def _rest_of(view: View, plates: Plates, exposure: Exposure) -> NDArray[np.float32]:
    return exposed_alike(to_floats(plates[view.camera.name].rgb), exposure.get(view.camera.name))


def _moving(difference: NDArray[np.float32], plate: Plate) -> NDArray[np.bool_]:
    """(H, W) where a picture less its plate (H, W, 3) is not noise.

    Its mean shows a shadow. The mean of its absolute values shows texture that moves, whose signs cancel.
    """
    shade = np.abs(box_mean(difference, WINDOW)) > plate.tolerance
    texture = box_mean(np.abs(difference), WINDOW) > plate.noise + 2 * plate.tolerance
    red, green, blue = np.moveaxis(shade | texture, 2, 0)  # numpy reduces so short an axis forty times slower
    return box_mean((red | green | blue).astype(np.float32), HALO) > 1e-6
