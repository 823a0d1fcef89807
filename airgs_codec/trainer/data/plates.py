"""Plates: what a camera that stands still sees where nothing moves, and the pixels of a frame that differ from it.

A plate is taken from a few frames of the whole run, so that it is the same however often a run is resumed, and its
noise is less than that of a picture. A pixel rests where the picture differs from the plate by less than the camera's
noise. Nothing is carried from frame to frame: what drifts away slowly leaves its plate in the end, too.

H x W pixels.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from airgs_codec.media.image import box_mean, to_bytes, to_floats
from airgs_codec.scene.camera import Camera
from airgs_codec.trainer.data.multiview import MultiviewScene
from airgs_codec.trainer.data.pictures import (
    TARGET_BYTES,
    Buffered,
    Exposure,
    Pictures,
    Recent,
    Target,
    View,
    exposed_alike,
)

FEWEST = 3  # frames of a run that has plates
SAMPLES = 16  # most frames that a plate is the median of
WINDOW = 5  # pixels that differences are averaged over: noise goes, a shadow's edge stays
LEAST, MOST = 3 / 255, 5 / 255  # bounds of the tolerance: more than that moves, however noisy a camera is
DEVIATIONS = 8.0 / WINDOW  # of a pixel's noise: four of the mean's, were it white, and twice that for what codecs leave
MEDIAN = 0.6745  # of the absolute value of a normal variable
HALO = 5  # pixels across: what moves, and what the Gaussians that make it reach


@dataclass(frozen=True, slots=True, eq=False)
class Plate:
    """The picture of one camera where nothing moves, and its noise."""

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


def stands_still(scene: MultiviewScene) -> bool:
    """Whether every camera is one of those of frame 0 and as it was there; pictures may be missing."""
    first = {camera.name: camera for camera in scene.cameras}
    return len(first) == len(scene.cameras) and all(
        len({shot.camera.name for shot in shots}) == len(shots)
        and all(
            (a := first.get(s.camera.name)) is not None
            and np.array_equal(a.world_to_camera, s.camera.world_to_camera)
            and _lens(a) == _lens(s.camera)
            for s in shots
        )
        for shots in scene.frames
    )


def _lens(camera: Camera) -> tuple[float, ...]:
    return camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy


def plate_sources(scene: MultiviewScene) -> list[tuple[int, list[int]]]:
    """Return what plates are taken from: training cameras, counted as the scene does, and the frames of each.

    None where a camera moves or there are too few frames.
    """
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


def settle(views: Sequence[View], plates: Plates, exposure: Exposure) -> tuple[list[View], Masks]:
    """Views as their plates have them where they rest, and where they do not (`find_moving`)."""

    def flatten(place: int) -> Target:
        target, rgb = views[place].target, _rest_of(views[place], plates, exposure)
        return Target(np.where(masks[place][..., None], target.rgb, rgb), target.clear)

    masks = find_moving(views, plates, exposure)
    buffer = Recent(flatten, TARGET_BYTES)
    return [replace(view, picture=Buffered(buffer, place)) for place, view in enumerate(views)], masks


def find_moving(views: Sequence[View], plates: Plates, exposure: Exposure) -> Masks:
    """The pixels of views that do not rest, and those right around them: they are as they were.

    `exposure`: of their pictures, as they were read.
    """
    return Masks(_moving(v.target.rgb - _rest_of(v, plates, exposure), plates[v.camera.name]) for v in views)


def _rest_of(view: View, plates: Plates, exposure: Exposure) -> NDArray[np.float32]:
    """(H, W, 3) what a view sees at rest, exposed as the view is."""
    rgb = to_floats(plates[view.camera.name].rgb)
    return exposed_alike(rgb, exposure[view.camera.name]) if view.camera.name in exposure else rgb


def _moving(difference: NDArray[np.float32], plate: Plate) -> NDArray[np.bool_]:
    """(H, W) where a picture less its plate (H, W, 3) is not noise.

    Its mean shows a shadow. The mean of its absolute values shows texture that moves, whose signs cancel.
    """
    shade = np.abs(box_mean(difference, WINDOW)) > plate.tolerance
    texture = box_mean(np.abs(difference), WINDOW) > plate.noise + 2 * plate.tolerance
    red, green, blue = np.moveaxis(shade | texture, 2, 0)  # numpy reduces so short an axis forty times slower
    return box_mean((red | green | blue).astype(np.float32), HALO) > 1e-6


def _noise(difference: NDArray[np.float32]) -> float:
    """Standard deviation of a pixel's noise, from two pictures' difference (H, W, 3) less what neighbours share."""
    return float(np.median(np.abs(difference - box_mean(difference, WINDOW)))) / MEDIAN
