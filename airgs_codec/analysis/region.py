"""What cameras see of a scene, and the viewing region that they suggest. C cameras, P places; N rows."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from airgs_codec.errors import ConfigError
from airgs_codec.package.tables import MAX_PLACES, Place, Region
from airgs_codec.render import Camera, measure_contribution
from airgs_codec.render.backend import CPU, Loaded, Renderer
from airgs_codec.scene.camera import in_picture, placed, resized, weighted_quantile, with_near_planes
from airgs_codec.scene.files import expecting
from airgs_codec.scene.gaussians import Gaussians

SIDE = 64  # pixels, the longest of pictures in which something must be seen
SEEN = 0.02  # of the opacity of all rows, from which cameras are of a scene
DATAPARSER = "dataparser_transforms.json"  # how nerfstudio turns and scales a scene before it trains it


@dataclass(frozen=True, slots=True)
class Sight:
    """What cameras see of a scene."""

    cameras: list[Camera]  # those that see something of it, with near planes in proportion
    blind: list[str]  # the names of the others
    share: float  # of the opacity of all rows, in some picture


def see(cameras: Sequence[Camera], gaussians: Gaussians, renderer: Renderer = CPU) -> Sight:
    """Return what cameras see of a frame, which is finite."""
    loaded, weights = renderer.load(gaussians), gaussians.opacities().astype(np.float64)
    drawn, near = np.zeros(len(weights), bool), with_near_planes(cameras, gaussians)
    for camera in near:
        drawn |= loaded.contribution(_small(camera, SIDE)).total > 0
    share = float(weights @ drawn / max(weights.sum(), np.finfo(np.float64).tiny))
    sees = [shows(loaded, camera) for camera in near]
    blind = [camera.name for camera, one in zip(near, sees, strict=True) if not one]
    return Sight([camera for camera, one in zip(near, sees, strict=True) if one], blind, share)


def seeing(cameras: Iterable[Camera], gaussians: Gaussians, renderer: Renderer = CPU) -> list[Camera]:
    """Return the cameras with near planes that see something of a frame; many opaque rows in a picture suffice."""
    loaded, opaque = renderer.load(gaussians), gaussians.means[gaussians.opacities() > 0.1].astype(np.float64)
    some = opaque[:: max(1, len(opaque) // 256)]

    def sees(camera: Camera) -> bool:
        return (len(some) >= 256 and in_picture(camera, some)[0].mean() > 0.1) or shows(loaded, camera)

    return list(filter(sees, cameras))


def shows(loaded: Loaded, camera: Camera) -> bool:
    """Return whether one of a thousand pixels of a camera's picture is at least 1 % opaque."""
    return float((loaded.draw(_small(camera, SIDE)).transmittance < 0.99).mean()) >= 1e-3


def _small(camera: Camera, side: int) -> Camera:
    return resized(camera, side / max(camera.width, camera.height))


def in_trained_frame(cameras: Sequence[Camera], path: Path) -> list[Camera]:
    """Return the cameras of a data set as nerfstudio trained on them, by a file DATAPARSER. Raises SceneError."""
    with expecting(path, '{"transform": [[…], …], "scale": number}'):
        data = json.loads(path.read_text(encoding="utf-8-sig"))
        transform, scale = np.asarray(data["transform"], np.float64).reshape(3, 4), float(data["scale"])
        if not (np.isfinite(transform).all() and 0 < scale < np.inf):
            raise ValueError("a transform or a scale that is none")
    return [placed(camera, transform[:, 3], scale, transform[:, :3]) for camera in cameras]


def region_around(
    cameras: Sequence[Camera], gaussians: Gaussians, *, margin: float | None = None, source: str = "cameras"
) -> Region:
    """Return the region about the cameras of a scene; `gaussians` are one of its frames, finite.

    Every camera is a place, or MAX_PLACES of them that are far from each other; of the cameras of a scene the one in
    the middle is the first, where viewers begin. Its focus is as far away as the median of what it sees. A place
    reaches as far as `margin` (world units): by default a quarter of the largest distance between two cameras or a
    tenth of the median distance to the content, whichever is larger, but at most a quarter of that distance; and never
    further than half-way to the nearest content. A viewer may look 5 degrees off the focus, without a margin 0.

    Raises ConfigError for a margin that is not 0 or more.
    """
    if margin is not None and not 0 <= margin < np.inf:
        raise ConfigError(f"margin: expected 0 or more world units, got {margin}")
    positions = np.stack([camera.position for camera in cameras])
    chosen = _far_apart(positions, MAX_PLACES)
    distances = [_distances(cameras[i], gaussians) for i in chosen]
    if margin is None:
        rig = float(np.linalg.norm(positions[chosen][:, None] - positions[chosen][None], axis=2).max())
        content = float(np.median([distance for distance, _ in distances]))
        margin = min(max(0.25 * rig, 0.1 * content), 0.25 * content)
    first = cameras[chosen[0]]
    places = []
    for camera, (distance, clearance) in zip((cameras[i] for i in chosen), distances, strict=True):
        rotation, position = camera.world_to_camera[:3, :3], camera.position
        ends = _rounded(position, distance), _rounded(position + distance * rotation[2], distance)
        reach = float(f"{min(margin, 0.5 * clearance):.7g}")
        places.append(Place(*ends, _rounded(-rotation[1], 1.0), reach))
    size: dict[str, Any] = {"width": first.width, "height": first.height, "turn": 5.0 if margin > 0 else 0.0}
    fov_y, near = float(np.degrees(2 * np.arctan(first.height / 2 / first.fy))), min(cameras[i].near for i in chosen)
    places = _middle_first(places) if source == "cameras" else places
    return Region(source=source, **size, fov_y=fov_y, near=near, places=places)


def _middle_first(places: list[Place]) -> list[Place]:
    """Return the places, first the one from which the others are nearest, with what they look at.

    Those all round a scene have no middle, except one above it where nobody would begin: their order stays.
    """
    ends = np.array([[place.position, place.focus] for place in places])
    up, ahead = np.mean([place.up for place in places], axis=0), ends[:, 1] - ends[:, 0]
    level = np.cross(up, np.cross(ahead, up))
    lengths = np.maximum(np.linalg.norm(level, axis=1, keepdims=True), np.finfo(np.float64).tiny)  # straight down: 0
    if np.linalg.norm(np.mean(level / lengths, axis=0)) < 0.5:  # they look in directions of more than 220 degrees
        return places
    middle = int(np.argmin([float(np.linalg.norm(ends - one, axis=2).sum()) for one in ends]))
    return [places[middle], *places[:middle], *places[middle + 1 :]]


def _rounded(vector: NDArray[np.float64], size: float) -> list[float]:
    """Round to a ten-millionth of `size`: nobody stands more exactly, and every viewer fetches them."""
    return [round(float(v), 7 - int(np.floor(np.log10(size)))) for v in vector]


def _distances(camera: Camera, g: Gaussians) -> tuple[float, float]:
    """Return the median distance along the view axis of what a camera sees, and that of its nearest part."""
    weight = measure_contribution(g, _small(camera, 128)).total
    offsets = g.means.astype(np.float64) - camera.position
    if not weight.any():  # an empty picture: all of the scene counts
        weight = np.ones(len(g))
    depth = np.abs(offsets @ camera.world_to_camera[2, :3])
    distance = max(weighted_quantile(depth, weight, 0.5), camera.near)  # near: of 0 the focus would have no direction
    return distance, weighted_quantile(np.linalg.norm(offsets, axis=1), weight, 0.02)


def _far_apart(positions: NDArray[np.float64], most: int) -> list[int]:
    """Return at most `most` of (C, 3) positions, each as far as possible from those before it, in their order."""
    chosen: list[int] = []
    nearest = np.full(len(positions), np.inf)
    for _ in range(min(most, len(positions))):
        chosen.append(int(np.argmax(nearest)))
        nearest = np.minimum(nearest, np.linalg.norm(positions - positions[chosen[-1]], axis=1))
        nearest[chosen] = -1  # once each, wherever the others stand
    return sorted(chosen)
