"""A room that stands still and one thing that moves about in it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tests.faces import Gaussians, join_rows
from tests.support.scenes import frozen, random_gaussians

MOVER = 0.05  # share of the rows


def room_behind_a_door(rows: int, open_: bool) -> Gaussians:
    """A room of `rows` rows and its mover; a wall of others hides it from cameras at z < -2, or has gone aside."""
    rng, wall = np.random.default_rng(5), random_gaussians(600, seed=9)
    means = np.c_[rng.uniform(-0.6, 0.6, (600, 2)), np.full(600, -2.0)] + [3.0 * open_, 0, 0]
    scales, logits = np.full((600, 3), -2.1, np.float32), np.full(600, 6, np.float32)
    wall = replace(wall, means=means.astype(np.float32), log_scales=scales, opacity_logits=logits)
    return frozen(join_rows([room_frames(rows, 1)[0], wall]))


def room_frames(rows: int, frames: int, degree: int = 0, seed: int = 0) -> list[Gaussians]:
    """Frames of `rows` rows on the walls of a box, the same bit by bit in all of them, and after them the mover's."""
    walls, rng = random_gaussians(rows, degree, seed), np.random.default_rng(seed)
    means, axis = rng.uniform(-1, 1, (rows, 3)), rng.integers(0, 3, rows)
    means[np.arange(rows), axis] = rng.choice([-1.0, 1.0], rows) + rng.normal(size=rows) * 0.02
    mover, out = random_gaussians(round(MOVER * rows), degree, seed + 1), []
    joined = join_rows([walls, mover])
    for t in range(frames):
        moved = mover.means * 0.3 + np.array([0.05 * t, 0.03 * np.sin(0.7 * t), 0.0])
        logits = np.concatenate([walls.opacity_logits, mover.opacity_logits + np.float32(0.02 * t)])
        placed = np.concatenate([means, moved]).astype(np.float32)
        out.append(frozen(replace(joined, means=placed, opacity_logits=logits)))
    return out
