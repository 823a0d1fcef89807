"""Cameras for scenes that come without, and paths through cameras."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from airgs_codec.scene.camera import Camera, look_at
from airgs_codec.scene.gaussians import Gaussians

FIELD_OF_VIEW = np.radians(50)
ELEVATIONS = np.radians([10.0, 35.0])  # of neighbouring cameras, in turn


def orbit_views(gaussians: Gaussians, count: int = 8, size: int = 256) -> list[Camera]:
    """`count` cameras on a ring around the scene, which is taken to be upright along +y.

    Centre: opacity-weighted median of the means; radius: 90 % of the opacity lies within. Rows that are not finite
    are passed over.
    """
    finite = np.isfinite(gaussians.means).all(axis=1) & np.isfinite(gaussians.opacity_logits)
    means = gaussians.means[finite].astype(np.float64) if finite.any() else np.zeros((1, 3))
    weights = gaussians.opacities()[finite].astype(np.float64) + 1e-6 if finite.any() else np.ones(1)
    centre = np.array([_quantile(means[:, axis], weights, 0.5) for axis in range(3)])
    distance = np.linalg.norm(means - centre, axis=1)
    radius = max(_quantile(distance, weights, 0.9), float(np.abs(centre).max()) * 1e-6, 1e-6)  # one point: any ring
    away = 1.15 * radius / np.tan(FIELD_OF_VIEW / 2)
    cameras = []
    for i in range(count):
        turn, rise = 2 * np.pi * i / count, ELEVATIONS[i % len(ELEVATIONS)]
        offset = np.array([np.cos(turn) * np.cos(rise), np.sin(rise), np.sin(turn) * np.cos(rise)])
        up = np.array([0.0, 1.0, 0.0])
        name = f"orbit{i:02d}"
        cameras.append(look_at(centre + away * offset, centre, up, size=size, fov_y=FIELD_OF_VIEW, name=name))
    return cameras


def _quantile(values: np.ndarray, weights: np.ndarray, share: float) -> float:
    order = np.argsort(values)
    total = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(total, share * total[-1])])


def camera_path(cameras: Sequence[Camera], count: int) -> list[Camera]:
    """`count` cameras from the first to the last of `cameras`: positions linear, rotations by slerp."""
    if len(cameras) == 1:
        return [cameras[0]] * count
    keys = np.arange(len(cameras))
    rotations = Slerp(keys, Rotation.from_matrix(np.stack([c.world_to_camera[:3, :3] for c in cameras])))
    positions = np.stack([c.position for c in cameras])
    path: list[Camera] = []
    for time in np.linspace(0, len(cameras) - 1, count):
        before = min(int(time), len(cameras) - 2)
        share = time - before
        matrix = np.eye(4)
        matrix[:3, :3] = rotations(time).as_matrix()
        matrix[:3, 3] = -matrix[:3, :3] @ ((1 - share) * positions[before] + share * positions[before + 1])
        path.append(replace(cameras[0], name=f"path{len(path):04d}", world_to_camera=matrix))
    return path
