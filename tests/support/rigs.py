"""A rig of cameras that look at a room of pictures, and what they film: real features, no renderer."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from airgs_codec.scene.camera import Camera, look_at
from tests.support.multiview_files import write_video

SIZE = 200  # pixels, both axes
WALL = 512  # pixels of a wall's picture
WALLS = (  # three corners of each: the first, and what is right of it and below it; y points down
    np.array([[-2.6, -2, -0.6], [0, -2, 2], [-2.6, 1, -0.6]]),
    np.array([[0, -2, 2], [2.6, -2, -0.6], [0, 1, 2]]),
    np.array([[-2.6, 1, -0.6], [0, 1, 2], [0, 1, -3.2]]),
)


def rig(count: int) -> list[Camera]:
    """Cameras on an arc that look into a corner, with two fields of view: no wall is square to the view axis."""
    cameras = []
    for i, turn in enumerate(np.linspace(-0.5, 0.5, count)):
        place = np.array([4 * np.sin(turn), 0.6 * (i % 3) - 0.6, -4 * np.cos(turn)])
        up = np.array([0.0, -1.0, 0.0])
        view = look_at(place, np.zeros(3), up, size=SIZE, fov_y=0.9 + 0.02 * (i % 2), name=f"cam{i:02d}")
        cameras.append(view)
    return cameras


def film_rig(folder: Path, cameras: list[Camera], frames: int = 2) -> Path:
    """The cameras' videos: walls with blobs, which do not move."""
    folder.mkdir(parents=True, exist_ok=True)
    walls = [_wall(seed) for seed in range(len(WALLS))]
    for camera in cameras:
        write_video(folder / f"{camera.name}.mp4", [_picture(camera, walls)] * frames)
    return folder


def _wall(seed: int) -> np.ndarray:
    """Random discs of many sizes."""
    rng = np.random.default_rng(seed)
    wall = np.full((WALL, WALL, 3), 128, np.uint8)
    for _ in range(700):
        centre, radius = tuple(map(int, rng.integers(0, WALL, 2))), int(rng.integers(3, 16))
        cv2.circle(wall, centre, radius, tuple(map(int, rng.integers(0, 256, 3))), -1, cv2.LINE_AA)
    return wall


def _picture(camera: Camera, walls: list[np.ndarray]) -> np.ndarray:
    """(H, W, 3) what a camera sees: each wall through the homography of its plane."""
    out = np.zeros((camera.height, camera.width, 3), np.uint8)
    lens = np.array([[camera.fx, 0, camera.cx - 0.5], [0, camera.fy, camera.cy - 0.5], [0, 0, 1]])
    for picture, (first, right, down) in zip(walls, WALLS, strict=True):
        plane = np.stack([(right - first) / WALL, (down - first) / WALL, first], axis=1)  # of (column, row, 1)
        homography = lens @ (camera.world_to_camera[:3, :3] @ plane + camera.world_to_camera[:3, 3:] * [0, 0, 1])
        ones = cv2.warpPerspective(np.ones((WALL, WALL), np.uint8), homography, (camera.width, camera.height))
        warped = cv2.warpPerspective(picture, homography, (camera.width, camera.height), flags=cv2.INTER_AREA)
        out[ones > 0] = warped[ones > 0]
    return out
