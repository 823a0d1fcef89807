"""A room that stands still and one thing that moves about in it."""

from __future__ import annotations

import numpy as np

from tests.faces import Gaussians
from tests.support.scenes import frozen, random_gaussians

MOVER = 0.05  # share of the rows


def room_behind_a_door(rows: int, open_: bool) -> Gaussians:
    """A room of `rows` rows and its mover; a wall of others hides it from cameras at z < -2, or has gone aside."""
    room, count = room_frames(rows, 1)[0], 600
    rng = np.random.default_rng(5)
    wall = random_gaussians(count, seed=9)
    means = np.c_[rng.uniform(-0.6, 0.6, (count, 2)), np.full(count, -2.0)] + [3.0 * open_, 0, 0]
    parts = {"means": means, "log_scales": np.full((count, 3), -2.1), "opacity_logits": np.full(count, 6.0)}
    columns = [(getattr(room, n), parts.get(n, getattr(wall, n))) for n in room.__slots__]
    return frozen(Gaussians(*(np.concatenate(pair).astype(np.float32) for pair in columns)))


def room_frames(rows: int, frames: int, degree: int = 0, seed: int = 0) -> list[Gaussians]:
    """Frames of `rows` rows on the walls of a box, the same bit by bit in all of them, and after them the mover's."""
    walls = random_gaussians(rows, degree, seed)
    rng = np.random.default_rng(seed)
    means = rng.uniform(-1, 1, (rows, 3))
    axis = rng.integers(0, 3, rows)
    means[np.arange(rows), axis] = rng.choice([-1.0, 1.0], rows) + rng.normal(size=rows) * 0.02
    mover = random_gaussians(round(MOVER * rows), degree, seed + 1)
    out = []
    for t in range(frames):
        shift = np.array([0.05 * t, 0.03 * np.sin(0.7 * t), 0.0])
        moved = mover.means * 0.3 + shift
        opacity = mover.opacity_logits + np.float32(0.02 * t)
        columns = [np.concatenate([getattr(walls, n), getattr(mover, n)]) for n in walls.__slots__[1:]]
        columns[walls.__slots__[1:].index("opacity_logits")] = np.concatenate([walls.opacity_logits, opacity])
        out.append(frozen(Gaussians(np.concatenate([means, moved]).astype(np.float32), *columns)))
    return out
