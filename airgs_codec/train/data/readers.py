"""Multi-view scenes on disk; each format is one function from a folder to a `Scene`.

transforms.json       nerfstudio: OpenGL camera-to-world, with `time_index` or `time`, `camera`, `split` a frame
train_meta.json       CMU Panoptic as Dynamic 3D Gaussians has it: fn, k, w2c [frame][camera], ims/, seg/ (masks)
sparse/ (COLMAP)      a static reconstruction, with videos/CAM.mp4 or images/CAM/* a camera, or one picture each
poses_bounds.npy      LLFF and N3DV: camera videos in the order of their names
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from airgs_codec.errors import SceneError
from airgs_codec.media.image import Lens, fit_lens
from airgs_codec.media.movie import VideoReader
from airgs_codec.scene.camera import Camera, camera_from_transforms
from airgs_codec.scene.ply import read_points
from airgs_codec.scene.sequence import DEFAULT_FPS, natural_key
from airgs_codec.train.data.colmap import find_model, read_model
from airgs_codec.train.data.multiview import PictureFile, Points, Scene, Shot, Source

VIDEO_SUFFIXES = (".mp4", ".mkv", ".mov", ".webm", ".avi")
PICTURE_SUFFIXES = (".png", ".jpg", ".jpeg", ".webp", ".tif", ".tiff", ".bmp")
# Metres. The cameras hang in the wall of a dome: what lies nearer is the wall that others see, and their own housing.
PANOPTIC_NEAR = 0.8
POINT_FILES = ("points3d.ply", "points3D.ply", "points_frame0.ply", "points.ply", "points3d.npy")


def is_multiview(folder: Path) -> bool:
    """Whether `folder` looks like multi-view video rather than a Gaussian sequence."""
    return _reader(folder) is not None and not any(p.name not in POINT_FILES for p in folder.glob("*.ply"))


def open_scene(folder: Path, *, fps: Fraction | None = None, frames: tuple[int, int | None] = (0, None)) -> Scene:
    """The scene in `folder`, frames [A, B) of it. Nothing is read from pictures yet.

    Raises SceneError when no format fits, a file is broken or missing, or the frames are not there.
    """
    read = _reader(folder)
    if read is None:
        kinds = "transforms.json, train_meta.json, COLMAP's sparse/ or poses_bounds.npy"
        raise SceneError(f"{folder}: expected multi-view pictures with {kinds}")
    scene = read(folder)
    start, stop = frames[0], len(scene) if frames[1] is None else frames[1]
    if not 0 <= start < stop <= len(scene):
        raise SceneError(f"{folder}: expected frames inside 0:{len(scene)}, got {start}:{stop}")
    for number, shots in enumerate(scene.frames):
        if not shots:
            raise SceneError(f"{folder}: expected pictures of frame {number}, got none")
    points = scene.points or (_given_points(folder) if start == 0 else None)
    return replace(scene, frames=scene.frames[start:stop], fps=fps or scene.fps, points=points)


def _reader(folder: Path) -> Callable[[Path], Scene] | None:
    if (folder / "train_meta.json").is_file():
        return read_panoptic
    if (folder / "transforms.json").is_file():
        return read_transforms
    if find_model(folder) is not None:
        return read_colmap
    return read_poses_bounds if (folder / "poses_bounds.npy").is_file() else None


def read_transforms(folder: Path) -> Scene:
    """nerfstudio; frames are the distinct `time_index`, else `time`; a file_path may name a video of all frames."""
    path = folder / "transforms.json"
    data = _json(path)
    try:
        entries = data["frames"]
        shots = [(_time(e), _transforms_shot(folder, data, e, n)) for n, e in enumerate(entries)]
    except (ValueError, KeyError, TypeError, AttributeError, np.linalg.LinAlgError) as error:
        raise SceneError(
            f"{path}: expected a nerfstudio transforms.json, got {type(error).__name__}: {error}"
        ) from error
    if not shots:
        raise SceneError(f"{path}: expected at least one picture under 'frames', got none")
    videos = {s.camera.name: folder / str(e["file_path"]) for (_, s), e in zip(shots, entries, strict=True)}
    if all(p.suffix.lower() in VIDEO_SUFFIXES for p in videos.values()):
        cameras = {s.camera.name: s for _, s in shots}
        return _from_videos(folder, [(cameras[name], video) for name, video in videos.items()])
    times = sorted({time for time, _ in shots})
    frames = tuple(tuple(s for time, s in shots if time == moment) for moment in times)
    return Scene(folder, Fraction(str(data.get("fps", DEFAULT_FPS))), frames)


def _transforms_shot(folder: Path, shared: dict[str, Any], entry: dict[str, Any], number: int) -> Shot:
    relative = Path(str(entry["file_path"]))
    name = str(entry.get("camera", relative.parent.name if _time(entry) else relative.stem or f"view{number:03d}"))
    camera = camera_from_transforms(name, shared, entry)
    coefficients = np.array([float(entry.get(k, shared.get(k, 0))) for k in ("k1", "k2", "p1", "p2", "k3")])
    model = str(entry.get("camera_model", shared.get("camera_model", "OPENCV")))
    lens = None
    if model == "OPENCV_FISHEYE":
        fisheye = np.array([float(entry.get(k, shared.get(k, 0))) for k in ("k1", "k2", "k3", "k4")])
        lens = fit_lens((camera.width, camera.height), _matrix(camera), fisheye, fisheye=True)
    elif coefficients.any():
        lens = fit_lens((camera.width, camera.height), _matrix(camera), coefficients)
    mask = folder / str(entry["mask_path"]) if "mask_path" in entry else None
    picture = folder / relative
    return Shot(
        _through(camera, lens), PictureFile(picture if picture.suffix else picture.with_suffix(".png")), lens, mask
    )


def _time(entry: dict[str, Any]) -> float:
    return float(entry.get("time_index", entry.get("time", 0)))


def read_panoptic(folder: Path) -> Scene:
    """OpenCV world-to-camera matrices; pictures in ims/, masks of what moves in seg/."""
    path = folder / "train_meta.json"
    data = _json(path)
    try:
        size = (int(data["w"]), int(data["h"]))
        frames = tuple(
            tuple(_panoptic_shot(folder, size, *shot) for shot in zip(*moment, strict=True))
            for moment in zip(data["fn"], data["k"], data["w2c"], data["cam_id"], strict=True)
        )
        fps = Fraction(str(data.get("fps", DEFAULT_FPS)))
    except (ValueError, KeyError, TypeError, IndexError) as error:
        raise SceneError(
            f"{path}: expected fn, k, w2c and cam_id a frame and camera, got {type(error).__name__}: {error}"
        ) from error
    if not frames:
        raise SceneError(f"{path}: expected at least one frame, got none")
    return Scene(folder, fps, frames)


def _panoptic_shot(folder: Path, size: tuple[int, int], file: str, k: Any, w2c: Any, camera_id: int) -> Shot:
    m, view = np.asarray(k, np.float64).reshape(3, 3), np.asarray(w2c, np.float64).reshape(4, 4)
    camera = Camera(f"cam{camera_id:02d}", *size, m[0, 0], m[1, 1], m[0, 2], m[1, 2], view, near=PANOPTIC_NEAR)
    mask = folder / "seg" / Path(file).with_suffix(".png")
    return Shot(camera, PictureFile(folder / "ims" / file), None, mask if mask.is_file() else None)


def read_colmap(folder: Path) -> Scene:
    """Images named CAM.ext or CAM/any.ext give the camera CAM; its pictures over time are a video or a folder."""
    model = find_model(folder)
    assert model is not None
    posed, points = read_model(model)
    shots: list[Shot] = []
    films: list[Path | None] = []
    for p in posed:
        relative = Path(p.name)
        name = relative.parent.name or relative.stem
        if name in [s.camera.name for s in shots]:  # further pictures of a camera that stands still
            continue
        shots.append(Shot(replace(p.camera, name=name), PictureFile(folder / "images" / relative), p.lens))
        films.append(_film(folder, name))
    if all(film is None for film in films):
        whole = [Shot(replace(p.camera, name=p.name), PictureFile(folder / "images" / p.name), p.lens) for p in posed]
        return Scene(folder, DEFAULT_FPS, (tuple(whole),), points)
    if missing := [s.camera.name for s, film in zip(shots, films, strict=True) if film is None]:
        raise SceneError(f"{folder}: expected a video or a folder of frames of {', '.join(missing)}")
    if all(film is not None and film.is_file() for film in films):
        scene = _from_videos(folder, [(s, f) for s, f in zip(shots, films, strict=True) if f])
    else:
        scene = _from_folders(folder, [(s, f) for s, f in zip(shots, films, strict=True) if f])
    return replace(scene, points=points)


def _film(folder: Path, name: str) -> Path | None:
    """A camera's pictures over time: a video, or a folder of more than one picture."""
    for place in (folder / "videos", folder):
        for suffix in VIDEO_SUFFIXES:
            if (place / f"{name}{suffix}").is_file():
                return place / f"{name}{suffix}"
    for place in (folder / "frames" / name, folder / "images" / name):
        if len(_pictures(place)) > 1:
            return place
    return None


def _pictures(folder: Path) -> list[Path]:
    if not folder.is_dir():
        return []
    return sorted((p for p in folder.iterdir() if p.suffix.lower() in PICTURE_SUFFIXES), key=natural_key)


def read_poses_bounds(folder: Path) -> Scene:
    """LLFF rows of 17: a 3 x 5 matrix (axes down, right, backwards; position; height, width, focal), near, far."""
    path = folder / "poses_bounds.npy"
    places = (folder, folder / "videos")
    videos = sorted(
        (p for f in places if f.is_dir() for p in f.iterdir() if p.suffix.lower() in VIDEO_SUFFIXES), key=natural_key
    )
    try:
        rows = np.load(path, allow_pickle=False).astype(np.float64).reshape(-1, 17)
    except (OSError, ValueError) as error:
        raise SceneError(f"{path}: expected rows of 17 numbers: {error}") from error
    if len(rows) != len(videos):
        raise SceneError(f"{path}: expected a row for each of {len(videos)} videos, got {len(rows)}")
    return _from_videos(folder, [(_llff_shot(row, v), v) for row, v in zip(rows, videos, strict=True)])


def _llff_shot(row: NDArray[np.float64], video: Path) -> Shot:
    pose = row[:15].reshape(3, 5)
    height, width, focal = pose[:, 4]
    real = VideoReader(video)
    real.close()
    x, y = real.size[0] / width, real.size[1] / height
    down, right, back = pose[:, 0], pose[:, 1], pose[:, 2]
    view = np.eye(4)
    view[:3, :3] = np.stack([right, down, -back])
    view[:3, 3] = -view[:3, :3] @ pose[:, 3]
    camera = Camera(video.stem, *real.size, focal * x, focal * y, real.size[0] / 2, real.size[1] / 2, view)
    return Shot(camera, PictureFile(video))


@dataclass(frozen=True, slots=True)
class VideoFrame:
    """A frame of a camera video."""

    path: Path
    number: int

    def read(self) -> NDArray[np.uint8]:
        """As `Source`."""
        return _video(self.path).read(self.number)

    def where(self) -> str:
        """As `Source`."""
        return f"{self.path} frame {self.number}"


@cache
def _video(path: Path) -> VideoReader:
    """One open decoder a video: frames are asked for in order."""
    return VideoReader(path)


def _from_videos(folder: Path, films: list[tuple[Shot, Path]]) -> Scene:
    """As many frames as the shortest video has."""
    videos = [_video(path) for _, path in films]
    rates = {v.fps for v in videos if v.fps}
    if len(rates) > 1:
        raise SceneError(
            f"{folder}: expected videos of one frame rate, got {', '.join(f'{float(r):g}' for r in rates)}"
        )

    def frame(number: int) -> tuple[Shot, ...]:
        return tuple(replace(shot, source=VideoFrame(path, number)) for shot, path in films)

    fps = Fraction(rates.pop()) if rates else DEFAULT_FPS
    return Scene(folder, fps, tuple(frame(t) for t in range(min(v.frames for v in videos))))


def _from_folders(folder: Path, films: list[tuple[Shot, Path]]) -> Scene:
    pictures = [_pictures(path) if path.is_dir() else [] for _, path in films]
    counts = sorted({len(p) for p in pictures})
    if len(counts) > 1:
        raise SceneError(f"{folder}: expected as many frames of every camera, got {counts[0]} to {counts[-1]}")

    def frame(number: int) -> tuple[Shot, ...]:
        sources: list[Source] = [PictureFile(paths[number]) for paths in pictures]
        return tuple(replace(shot, source=source) for (shot, _), source in zip(films, sources, strict=True))

    return Scene(folder, DEFAULT_FPS, tuple(frame(t) for t in range(counts[0])))


def _given_points(folder: Path) -> Points | None:
    for name in POINT_FILES:
        path = folder / name
        if not path.is_file():
            continue
        if path.suffix == ".ply":
            return Points(*read_points(path))
        try:
            table = np.load(path, allow_pickle=False).astype(np.float32)
            positions, colours = table[:, :3], table[:, 3:6] if table.shape[1] >= 6 else None
        except (OSError, ValueError, IndexError) as error:
            raise SceneError(f"{path}: expected rows of x, y, z [, r, g, b]: {error}") from error
        return Points(positions, colours)
    return None


def _through(camera: Camera, lens: Lens | None) -> Camera:
    if lens is None:
        return camera
    m = lens.pinhole
    return replace(camera, fx=m[0, 0], fy=m[1, 1], cx=m[0, 2], cy=m[1, 2])


def _matrix(camera: Camera) -> NDArray[np.float64]:
    return np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]])


def _json(path: Path) -> dict[str, Any]:
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise SceneError(f"{path}: expected JSON: {error}") from error
    if not isinstance(data, dict):
        raise SceneError(f"{path}: expected a JSON object, got {type(data).__name__}")
    return data
