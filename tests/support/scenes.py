"""Seeded synthetic scenes, and the embedded one."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np

from tests.faces import SH_REST, Gaussians, join_rows, orbit_views, read_ply, to_matrices, write_ply
from tests.support.multiview_files import write_cameras
from tests.support.paths import FOX

JITTER, LOST, SPLIT = 0.1, 0.05, 0.05  # of a size, and shares of the rows
MOVER = 0.05  # share of the rows of a room that move about in it


def random_gaussians(count: int, degree: int = 0, seed: int = 0) -> Gaussians:
    rng, size = np.random.default_rng(seed), np.log(0.6 / max(count, 2) ** (1 / 3))
    arrays = [rng.normal(size=(count, 3)) * 0.5, rng.normal(size=(count, 4))]
    arrays += [size + rng.normal(size=(count, 3)) * 0.4, rng.normal(size=count) * 2]
    arrays += [rng.normal(size=(count, 3)) * 0.6, rng.normal(size=(count, SH_REST[degree], 3)) * 0.1]
    return frozen(Gaussians(*(a.astype(np.float32) for a in arrays)))


def predicted(g: Gaussians, rng: np.random.Generator) -> Gaussians:
    """A frame in another order, as another training would have it.

    LOST of the rows are left out, SPLIT of them become two that are 1.6 times smaller, and all means are moved by a
    normal draw of JITTER of each axis of their Gaussian.
    """
    g = g.take(rng.permutation(len(g))[round(LOST * len(g)) :])
    splits = round(SPLIT * len(g))
    g = g.take(np.concatenate([np.arange(len(g)), np.arange(splits)]))
    halves = np.concatenate([np.arange(splits), np.arange(len(g) - splits, len(g))])
    scales = g.log_scales.copy()
    scales[halves] -= np.float32(math.log(1.6))
    away = rng.normal(size=(splits, 3)) / 2
    local = JITTER * rng.normal(size=(len(g), 3))
    local[halves] += np.concatenate([away, -away])
    turned = np.einsum("nij,nj->ni", to_matrices(g.quaternions), local * np.exp(g.log_scales))
    moved = replace(g, means=(g.means + turned).astype(np.float32), log_scales=scales)
    return moved.take(rng.permutation(len(g)))


def frozen(g: Gaussians) -> Gaussians:
    """The same arrays, read-only: code that writes into its argument fails."""
    for name in g.__slots__:
        getattr(g, name).flags.writeable = False
    return g


def moving_frames(count: int, frames: int, degree: int = 0, seed: int = 0) -> list[Gaussians]:
    first, moves = random_gaussians(count, degree, seed), (np.arange(count) % 2)[:, None]
    shifts = (np.array([0.3 * np.sin(0.4 * t), 0.1 * t, 0], np.float32) * moves for t in range(frames))
    return [frozen(replace(first, means=(first.means + shift).astype(np.float32))) for shift in shifts]


def write_sequence(folder: Path, frames: list[Gaussians], *, cameras: bool = True, **settings: object) -> Path:
    """A sequence on disk; without cameras an encode searches for places to see it from, which takes a second."""
    folder.mkdir(parents=True, exist_ok=True)
    for i, frame in enumerate(frames):
        write_ply(folder / f"{i:06d}.ply", frame)
    if cameras:
        write_cameras(folder / "transforms.json", orbit_views(frames[0], count=4, size=64))
    if settings:
        (folder / "sequence.json").write_text(json.dumps(settings))
    return folder


def write_demo(folder: Path, frames: int, rows: int, scale: float) -> Path:
    """The first frames and rows of the embedded scene, and its cameras with pictures `scale` times as wide and high."""
    folder.mkdir(parents=True)
    for path in sorted(FOX.glob("*.ply"))[:frames]:
        write_ply(folder / path.name, read_ply(path).take(slice(0, rows)))
    views = json.loads((FOX / "transforms.json").read_text())
    views |= {name: int(views[name] * scale) for name in ("w", "h")}
    views |= {name: views[name] * scale for name in ("fl_x", "fl_y", "cx", "cy")}
    (folder / "transforms.json").write_text(json.dumps(views))
    return folder


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
