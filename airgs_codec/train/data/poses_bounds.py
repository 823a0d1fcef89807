"""Multi-view scenes of a poses_bounds.npy: a row for each camera's video, in the order of their names.

N3DV's videos are cam00.mp4 to cam20.mp4 with gaps where a camera was not in time; cam00 is the one it holds out.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from airgs_codec.errors import SceneError
from airgs_codec.scene.camera import Camera, with_pixels
from airgs_codec.scene.cameras import llff
from airgs_codec.scene.formats.table import natural_key
from airgs_codec.train.data.multiview import MultiviewScene, Shot, Source
from airgs_codec.train.data.videos import CameraFilm, find_videos, scene_from_films, video_size

HELD_OUT = "cam00"


def read_poses_bounds(folder: Path) -> MultiviewScene:
    """The scene of a poses_bounds.npy; videos lie beside it or in videos/. Raises SceneError."""
    path = folder / llff.NAME
    videos = sorted(find_videos(folder) + find_videos(folder / "videos"), key=natural_key)
    cameras = [p.camera for p in llff.read(path)]
    if len(cameras) != len(videos):
        raise SceneError(f"{path}: expected a row for each of {len(videos)} videos, got {len(cameras)}")
    if twice := sorted({v.stem for v in videos if [w.stem for w in videos].count(v.stem) > 1}):
        raise SceneError(f"{folder}: expected one video for each camera, got several of {', '.join(twice)}")
    return scene_from_films(folder, [CameraFilm(_shot(c, v), v) for c, v in zip(cameras, videos, strict=True)])


def _shot(camera: Camera, video: Path) -> Shot:
    width, height = video_size(video)  # the matrix may be of the videos before they were shrunk
    split = "test" if video.stem == HELD_OUT else "train"
    filmed = replace(with_pixels(camera, width, height), name=video.stem, split=split)
    return Shot(filmed, Source(video))
