"""Synthetic scenes that are meant to be seen from somewhere: places that were filmed, objects, and neither."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from airgs_codec.scene.gaussians import Gaussians
from tests.support.views import joined


def discs(means: NDArray, normals: NDArray, size: float, thickness: float = 0.05) -> Gaussians:
    """Opaque discs of radius `size`, upright on their normals (N, 3), of `thickness` radii."""
    count, rng = len(means), np.random.default_rng(len(means))
    quaternions = np.concatenate([1 + normals[:, 2:], -normals[:, 1:2], normals[:, :1], np.zeros((count, 1))], axis=1)
    quaternions[np.linalg.norm(quaternions, axis=1) < 1e-6] = (0, 1, 0, 0)  # turns z to -z
    scales = np.log(size) + np.array([0, 0, np.log(thickness)])
    colours = rng.normal(size=(count, 3)) * 0.3
    return _gaussians(means, quaternions, np.tile(scales, (count, 1)), np.full(count, 4.0), colours)


def ball(count: int = 3000, radius: float = 0.5) -> Gaussians:
    directions = np.random.default_rng(1).normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return discs(radius * directions, directions, 2 * radius / np.sqrt(count))


def floor(height: float, count: int = 2000) -> Gaussians:
    """A square floor of 2 x 2 units at y = `height`."""
    x, z = np.random.default_rng(2).uniform(-1, 1, (2, count))
    return discs(np.stack([x, np.full(count, height), z], axis=1), np.tile([0.0, 1.0, 0.0], (count, 1)), 0.05)


def needles(count: int = 3000, seed: int = 0, length: float = 0.5) -> Gaussians:
    """What is left of a scene in which nothing was understood: long needles in every direction."""
    rng = np.random.default_rng(seed)
    scales = np.log(length * np.array([1, 0.06, 0.06])) + rng.normal(size=(count, 3)) * 0.2
    means, quaternions, colours = rng.normal(size=(count, 3)), rng.normal(size=(count, 4)), rng.normal(size=(count, 3))
    return _gaussians(means, quaternions, scales, rng.normal(size=count) + 1, colours)


def filmed_room() -> Gaussians:
    """A room filmed from its middle towards the wall at z = 4: small discs there, needles behind and all around."""
    rng = np.random.default_rng(3)
    x, y = rng.uniform(-4, 4, (2, 6000))
    depth = 4 + 0.3 * np.sin(x) + 0.2 * np.cos(2 * y)
    wall = discs(np.stack([x, y, depth], axis=1), np.tile([0.0, 0.0, -1.0], (6000, 1)), 0.07)
    shell = needles(3000, length=1.5)
    around = rng.uniform(-5, 5, (3000, 3))
    side = rng.integers(0, 3, 3000)
    around[np.arange(3000), side] = rng.choice([-1, 1], 3000) * rng.uniform(4.5, 5.5, 3000)
    return joined(wall, replace(shell, means=around.astype(np.float32)))


def _gaussians(means: NDArray, quaternions: NDArray, log_scales: NDArray, logits: NDArray, dc: NDArray) -> Gaussians:
    empty = np.zeros((len(means), 0, 3), np.float32)
    columns = [column.astype(np.float32) for column in (means, quaternions, log_scales, logits, dc)]
    return Gaussians(columns[0], columns[1], columns[2], columns[3], columns[4], empty)
