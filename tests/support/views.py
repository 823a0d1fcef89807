"""Multi-view pictures of synthetic scenes, on disk."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np

from airgs_codec.media.image import to_bytes, write_png
from airgs_codec.render import Camera, render
from airgs_codec.scene.camera import OPENGL_TO_OPENCV, look_at
from airgs_codec.scene.gaussians import Gaussians
from airgs_codec.train.data.multiview import View
from airgs_codec.train.loss.target import Target

BALL = np.array([0.9, 0.9, 0.0])  # where something appears


def ring(count: int = 8, size: int = 48, held_out: int = 0) -> list[Camera]:
    """Cameras around the origin; the last `held_out` are for testing."""
    cameras = []
    for i in range(count):
        turn, rise = 2 * np.pi * i / count, (0.2, 0.6)[i % 2]
        place = 5 * np.array([np.cos(turn) * np.cos(rise), np.sin(rise), np.sin(turn) * np.cos(rise)])
        camera = look_at(place, np.zeros(3), np.array([0.0, -1.0, 0.0]), size=size, fov_y=0.8, name=f"cam{i:02d}")
        cameras.append(replace(camera, split="test" if i >= count - held_out else "train"))
    return cameras


def coloured_cloud(count: int = 150, seed: int = 0) -> Gaussians:
    """Opaque blobs on a sphere."""
    rng = np.random.default_rng(seed)
    means = rng.normal(size=(count, 3))
    means *= 0.8 / np.linalg.norm(means, axis=1, keepdims=True)
    return Gaussians(
        means.astype(np.float32),
        np.tile(np.array([1, 0, 0, 0], np.float32), (count, 1)),
        np.full((count, 3), np.log(0.12), np.float32),
        np.full(count, 3.0, np.float32),
        np.sin(4 * means).astype(np.float32),
        np.zeros((count, 0, 3), np.float32),
    )


def joined(*parts: Gaussians) -> Gaussians:
    """All rows, one after another."""
    return Gaussians(*(np.concatenate([getattr(p, n) for p in parts]) for n in parts[0].__slots__))


def moved(g: Gaussians, rows: slice, by: tuple[float, float, float]) -> Gaussians:
    """Some rows elsewhere."""
    means = g.means.copy()
    means[rows] += np.array(by, np.float32)
    return Gaussians(means, *(getattr(g, n) for n in g.__slots__[1:]))


def appeared(count: int = 40) -> Gaussians:
    """A bright ball in empty space."""
    ball = coloured_cloud(count, seed=9)
    means = (0.3 * ball.means + BALL).astype(np.float32)
    return Gaussians(means, *ball_shape(ball))


def ball_shape(ball: Gaussians) -> list[np.ndarray]:
    """The other columns: smaller, white."""
    return [
        ball.quaternions,
        ball.log_scales - 0.5,
        ball.opacity_logits,
        np.full_like(ball.sh_dc, 1.5),
        ball.sh_rest,
    ]


def views_of(g: Gaussians, cameras: list[Camera]) -> list[View]:
    """What the cameras see of `g`."""
    return [View(c, Target(np.clip(render(g, c).rgb, 0, 1))) for c in cameras]


def matrix_of(camera: Camera) -> list[list[float]]:
    """OpenGL camera-to-world, as transforms.json has it."""
    return (np.linalg.inv(camera.world_to_camera) @ OPENGL_TO_OPENCV).tolist()


def write_views(folder: Path, frames: list[Gaussians], cameras: list[Camera], points: np.ndarray | None) -> Path:
    """A dynamic transforms.json with PNG pictures."""
    entries = []
    for t, g in enumerate(frames):
        for c in cameras:
            path = folder / "images" / c.name / f"{t:04d}.png"
            path.parent.mkdir(parents=True, exist_ok=True)
            write_png(path, to_bytes(render(g, c).rgb))
            entry = {"file_path": str(path.relative_to(folder)), "camera": c.name, "split": c.split, "time_index": t}
            entries.append({**entry, "transform_matrix": matrix_of(c)})
    c = cameras[0]
    shared = {"w": c.width, "h": c.height, "fl_x": c.fx, "fl_y": c.fy, "cx": c.cx, "cy": c.cy, "fps": 12}
    (folder / "transforms.json").write_text(json.dumps({**shared, "frames": entries}))
    if points is not None:
        np.save(folder / "points3d.npy", points.astype(np.float32))
    return folder
