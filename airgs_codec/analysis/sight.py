"""What cameras see of a scene: those that see nothing of it tell nothing, however well two pictures agree."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from airgs_codec.render.backend import CPU, Loaded, Renderer
from airgs_codec.scene.camera import Camera, in_picture, placed, resized, with_near_planes
from airgs_codec.scene.files import expecting
from airgs_codec.scene.gaussians import Gaussians

SIDE = 64  # pixels, the longest of pictures that are looked at
LIT = 1e-3  # of the pixels of a picture, from which it shows something
OPAQUE = 0.01  # of a pixel, from which it is lit: a faint scene is one, too
SOLID, FEW, MANY = 0.1, 256, 0.1  # opacity of rows, so many of them, and the share of these, that surely show something
SEEN = 0.02  # of the opacity of all rows, from which cameras are of a scene
DATAPARSER = "dataparser_transforms.json"  # how nerfstudio turns and scales a scene before it trains it


@dataclass(frozen=True, slots=True)
class Sight:
    """What cameras see of a scene."""

    cameras: list[Camera]  # those that see something of it, with near planes in proportion
    blind: list[str]  # the names of the others
    share: float  # of the opacity of all rows, in some picture


def see(cameras: Sequence[Camera], gaussians: Gaussians, renderer: Renderer = CPU) -> Sight:
    """Look at a frame, which is finite, with cameras."""
    loaded = renderer.load(gaussians)
    weights, found = gaussians.opacities().astype(np.float64), []
    drawn, blind = np.zeros(len(weights), bool), []
    for camera in with_near_planes(cameras, gaussians):
        small = resized(camera, SIDE / max(camera.width, camera.height))
        drawn |= loaded.contribution(small).total > 0
        if shows(loaded, camera):
            found.append(camera)
        else:
            blind.append(camera.name)
    return Sight(found, blind, float(weights @ drawn / max(weights.sum(), np.finfo(np.float64).tiny)))


def seeing(cameras: Iterable[Camera], gaussians: Gaussians, renderer: Renderer = CPU) -> list[Camera]:
    """Those of some cameras with near planes that see something of a frame.

    A camera that has many opaque rows in its picture is not tried.
    """
    loaded, opaque = renderer.load(gaussians), gaussians.means[gaussians.opacities() > SOLID].astype(np.float64)
    some = opaque[:: max(1, len(opaque) // FEW)]

    def sees(camera: Camera) -> bool:
        return (len(some) >= FEW and in_picture(camera, some)[0].mean() > MANY) or shows(loaded, camera)

    return [camera for camera in cameras if sees(camera)]


def shows(loaded: Loaded, camera: Camera) -> bool:
    """Whether a camera sees something."""
    small = resized(camera, SIDE / max(camera.width, camera.height))
    return float((loaded.draw(small).transmittance < 1 - OPAQUE).mean()) >= LIT


def in_trained_frame(cameras: Sequence[Camera], path: Path) -> list[Camera]:
    """The cameras of a data set as nerfstudio trained on them, which DATAPARSER tells. Raises SceneError."""
    with expecting(path, '{"transform": [[…], …], "scale": number}'):
        data = json.loads(path.read_text(encoding="utf-8-sig"))
        transform, scale = np.asarray(data["transform"], np.float64).reshape(3, 4), float(data["scale"])
        if not (np.isfinite(transform).all() and 0 < scale < np.inf):
            raise ValueError("a transform or a scale that is none")
    return [placed(camera, transform[:, 3], scale, transform[:, :3]) for camera in cameras]
