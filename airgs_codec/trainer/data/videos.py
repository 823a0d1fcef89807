"""Pictures over time: a video or a folder of pictures for each camera. T frames.

A poses_bounds.npy has a row for each camera's video, in the order of their names. N3DV's videos are cam00.mp4 to
cam20.mp4 with gaps where a camera was not in time; cam00 is the one it holds out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path

from airgs_codec.errors import SceneError
from airgs_codec.scene.beside import DEFAULT_FPS
from airgs_codec.scene.camera import Camera, with_pixels
from airgs_codec.scene.cameras import forms
from airgs_codec.scene.formats.table import natural_key
from airgs_codec.trainer.data.multiview import MultiviewScene, Shot, Source, open_video

VIDEO_SUFFIXES = (".mp4", ".mkv", ".mov", ".webm", ".avi")
SAME_RATE = 1.001  # ratio of frame rates that cameras of one rig measure a little differently
HELD_OUT = "cam00"  # of N3DV
PICTURE_SUFFIXES = (".png", ".jpg", ".jpeg", ".webp", ".tif", ".tiff", ".bmp")


@dataclass(frozen=True, slots=True)
class CameraFilm:
    """A camera that stands still, and what it filmed."""

    shot: Shot  # its camera, lens and mask; its source is replaced frame by frame
    path: Path  # a video, or a folder of pictures in the order of their names


def scene_from_films(folder: Path, films: Sequence[CameraFilm]) -> MultiviewScene:
    """The scene that these cameras filmed: all of them videos, or all of them folders of pictures.

    Raises SceneError where frame rates of videos or counts of pictures differ, or a video cannot be read.
    """
    return _from_folders(folder, films) if any(film.path.is_dir() for film in films) else _from_videos(folder, films)


def find_videos(folder: Path) -> list[Path]:
    """The videos in a folder by name; a folder that is not there has none."""
    return _with_suffix(folder, VIDEO_SUFFIXES)


def find_pictures(folder: Path) -> list[Path]:
    """The pictures in a folder by name; a folder that is not there has none."""
    return _with_suffix(folder, PICTURE_SUFFIXES)


def read_poses_bounds(folder: Path) -> MultiviewScene:
    """The scene of a poses_bounds.npy; videos lie beside it or in videos/. Raises SceneError."""
    path = folder / forms.LLFF
    videos = sorted(find_videos(folder) + find_videos(folder / "videos"), key=natural_key)
    cameras = [p.camera for p in forms.read_llff(path)]
    if len(cameras) != len(videos):
        raise SceneError(f"{path}: expected a row for each of {len(videos)} videos, got {len(cameras)}")
    if twice := sorted({v.stem for v in videos if [w.stem for w in videos].count(v.stem) > 1}):
        raise SceneError(f"{folder}: expected one video for each camera, got several of {', '.join(twice)}")
    return scene_from_films(folder, [CameraFilm(_filmed(c, v), v) for c, v in zip(cameras, videos, strict=True)])


def _filmed(camera: Camera, video: Path) -> Shot:
    width, height = open_video(video).size  # the matrix may be of the videos before they were shrunk
    split = "test" if video.stem == HELD_OUT else "train"
    filmed = replace(with_pixels(camera, width, height), name=video.stem, split=split)
    return Shot(filmed, Source(video))


def _with_suffix(folder: Path, suffixes: Sequence[str]) -> list[Path]:
    if not folder.is_dir():
        return []
    return sorted((path for path in folder.iterdir() if path.suffix.lower() in suffixes), key=natural_key)


def _from_videos(folder: Path, films: Sequence[CameraFilm]) -> MultiviewScene:
    """As many frames as the shortest video has."""
    videos = [open_video(film.path) for film in films]
    rates = sorted({video.fps for video in videos if video.fps})
    if rates and rates[-1] > SAME_RATE * rates[0]:
        listed = ", ".join(f"{float(rate):g}" for rate in rates)
        raise SceneError(f"{folder}: expected videos of one frame rate, got {listed}")
    count = min(video.frames for video in videos)
    sources = [[Source(film.path, number) for number in range(count)] for film in films]
    return _with_sources(folder, Fraction(rates[0]) if rates else DEFAULT_FPS, films, sources)


def _from_folders(folder: Path, films: Sequence[CameraFilm]) -> MultiviewScene:
    pictures = [find_pictures(film.path) for film in films]
    counts = sorted({len(paths) for paths in pictures})
    if len(counts) > 1:
        raise SceneError(f"{folder}: expected as many frames of every camera, got {counts[0]} to {counts[-1]}")
    return _with_sources(folder, DEFAULT_FPS, films, [[Source(path) for path in paths] for paths in pictures])


def _with_sources(
    folder: Path, fps: Fraction, films: Sequence[CameraFilm], sources: Sequence[Sequence[Source]]
) -> MultiviewScene:
    """`sources`: the T pictures of each camera."""
    frames = tuple(
        tuple(replace(film.shot, source=source) for film, source in zip(films, moment, strict=True))
        for moment in zip(*sources, strict=True)
    )
    return MultiviewScene(folder, fps, frames)
