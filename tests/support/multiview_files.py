"""Multi-view scenes on disk, in the formats that people have."""

from __future__ import annotations

import json
from collections.abc import Iterable
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np

from tests.faces import OPENGL_TO_OPENCV, Camera, Gaussians, render, to_bytes, write_png


def matrix_of(camera: Camera) -> list[list[float]]:
    return (np.linalg.inv(camera.world_to_camera) @ OPENGL_TO_OPENCV).tolist()


def write_cameras(path: Path, cameras: list[Camera]) -> Path:
    entries = [{"camera": c.name, "split": c.split, "transform_matrix": matrix_of(c)} for c in cameras]
    _write_transforms(path, cameras[0], entries)
    return path


def _write_transforms(path: Path, c: Camera, entries: list[dict[str, Any]]) -> None:
    shared = {"w": c.width, "h": c.height, "fl_x": c.fx, "fl_y": c.fy, "cx": c.cx, "cy": c.cy, "fps": 12}
    path.write_text(json.dumps({**shared, "frames": entries}))


def write_views(folder: Path, frames: list[Gaussians], cameras: list[Camera], points: np.ndarray | None) -> Path:
    entries = []
    for t, g in enumerate(frames):
        for c in cameras:
            path = folder / "images" / c.name / f"{t:04d}.png"
            path.parent.mkdir(parents=True, exist_ok=True)
            write_png(path, to_bytes(render(g, c).rgb))
            entry = {"file_path": str(path.relative_to(folder)), "camera": c.name, "split": c.split, "time_index": t}
            entries.append({**entry, "transform_matrix": matrix_of(c)})
    _write_transforms(folder / "transforms.json", cameras[0], entries)
    if points is not None:
        np.save(folder / "points3d.npy", points.astype(np.float32))
    return folder


def plain(value: int, size: tuple[int, int] = (32, 24)) -> np.ndarray:
    return np.full((size[1], size[0], 3), value, np.uint8)


def write_video(path: Path, pictures: list[np.ndarray], times: Iterable[float] = range(1 << 20)) -> None:
    """25 pictures a second; `times`: of the pictures, in frames."""
    with av.open(str(path), "w", options={"movflags": "faststart"}) as container:
        stream = container.add_stream("libx264", rate=25, options={"qp": "1", "bf": "2"})
        stream.height, stream.width = pictures[0].shape[:2]
        stream.pix_fmt, stream.codec_context.time_base = "yuv420p", Fraction(1, 2500)
        for picture, time in zip(pictures, times, strict=False):
            frame = av.VideoFrame.from_ndarray(picture, format="rgb24")
            frame.pts, frame.time_base = round(100 * time), Fraction(1, 2500)
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))


def write_filmed(folder: Path, camera: Camera, films: dict[str, tuple[list[np.ndarray], Iterable[float]]]) -> Path:
    """A scene of videos, by their names, each of pictures and their times in frames; one camera took them all."""
    entries = []
    for name, (pictures, times) in films.items():
        write_video(folder / name, pictures, times=times)
        entries.append({"file_path": name, "camera": Path(name).stem, "transform_matrix": matrix_of(camera)})
    _write_transforms(folder / "transforms.json", camera, entries)
    return folder


def same_camera(a: Camera, b: Camera) -> bool:
    one, other = ([c.fx, c.fy, c.cx, c.cy] for c in (a, b))
    return np.allclose(a.world_to_camera, b.world_to_camera, atol=1e-5) and np.allclose(one, other, atol=1e-4)
