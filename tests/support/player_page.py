"""The page that tries the player (web/test/pages/player.ts), and what its pictures are to be."""

import base64
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tests.faces import Camera, Package, before_background, mse, psnr

PAGE = b'<!doctype html><link rel="icon" href="data:,"><script type="module" src="/web/out/pages/player.js"></script>'
LEAST_DB = 55  # of pictures of 8 bits


def camera_of(package: Package, report: Any) -> Camera:
    """The camera of the page, before the background of a package."""
    lens = report["camera"]
    matrix = np.array(lens["worldToCamera"]).reshape(4, 4)
    numbers = {k: lens[k] for k in ("width", "height", "fx", "fy", "cx", "cy", "near")}
    [camera] = before_background(package.manifest.region, [Camera("page", world_to_camera=matrix, **numbers)])
    return camera


def decibels(picture: str, truth: NDArray[np.float32]) -> float:
    """PSNR of a picture of the page against r, g, b."""
    pixels = np.frombuffer(base64.b64decode(picture), np.uint8).reshape(*truth.shape[:2], 4)[..., :3]
    rounded = np.round(255 * truth.clip(0, 1)) / np.float32(255)
    assert rounded.std() > 0.05
    return psnr(mse((pixels / 255).astype(np.float32), rounded.astype(np.float32)))
