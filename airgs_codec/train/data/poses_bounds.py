"""Reader of LLFF's poses_bounds.npy as N3DV has it: one row for each camera's video, in the order of their names.

A row has 17 numbers: a 3 x 5 matrix (axes down, right, backwards; position; height, width, focal length in pixels), and
the nearest and farthest depth.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from airgs_codec.errors import SceneError
from airgs_codec.scene.camera import Camera
from airgs_codec.scene.sequence import natural_key
from airgs_codec.train.data.multiview import MultiviewScene, PictureFile, Shot
from airgs_codec.train.data.videos import CameraFilm, find_videos, scene_from_films, video_size

NAME = "poses_bounds.npy"


def has_poses_bounds(folder: Path) -> bool:
    """Whether the folder has a poses_bounds.npy."""
    return (folder / NAME).is_file()


def read_poses_bounds(folder: Path) -> MultiviewScene:
    """The scene of a poses_bounds.npy; videos lie beside it or in videos/. Raises SceneError."""
    path = folder / NAME
    videos = sorted(find_videos(folder) + find_videos(folder / "videos"), key=natural_key)
    try:
        rows = np.load(path, allow_pickle=False).astype(np.float64).reshape(-1, 17)
    except (OSError, ValueError) as error:
        raise SceneError(f"{path}: expected rows of 17 numbers: {error}") from error
    if len(rows) != len(videos):
        raise SceneError(f"{path}: expected a row for each of {len(videos)} videos, got {len(rows)}")
    return scene_from_films(folder, [CameraFilm(_shot(row, v), v) for row, v in zip(rows, videos, strict=True)])


def _shot(row: NDArray[np.float64], video: Path) -> Shot:
    pose = row[:15].reshape(3, 5)
    height, width, focal = pose[:, 4]
    size = video_size(video)  # the matrix may be of the videos before they were shrunk
    x, y = size[0] / width, size[1] / height
    down, right, back = pose[:, 0], pose[:, 1], pose[:, 2]
    view = np.eye(4)
    view[:3, :3] = np.stack([right, down, -back])
    view[:3, 3] = -view[:3, :3] @ pose[:, 3]
    camera = Camera(video.stem, *size, focal * x, focal * y, size[0] / 2, size[1] / 2, view)
    return Shot(camera, PictureFile(video))
