"""Synthetic scenes that change over time, and cameras that see them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch

from airgs_codec.analysis.sensitivity import measure_views
from tests.faces import Camera, Gaussians, Parameters, Target, Usage, View, from_gaussians, join_rows, look_at, render
from tests.support.scenes import random_gaussians

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


def without_sh(means: np.ndarray, *others: np.ndarray) -> Gaussians:
    """Gaussians of SH degree 0 of the other columns, of any type."""
    return Gaussians(*(column.astype(np.float32) for column in (means, *others, np.zeros((len(means), 0, 3)))))


def coloured_cloud(count: int = 150, seed: int = 0) -> Gaussians:
    rng = np.random.default_rng(seed)
    means = rng.normal(size=(count, 3))
    means *= 0.8 / np.linalg.norm(means, axis=1, keepdims=True)
    turns, scales, logits = np.tile([1.0, 0, 0, 0], (count, 1)), np.full((count, 3), np.log(0.12)), np.full(count, 3.0)
    return without_sh(means, turns, scales, logits, np.sin(4 * means))


def random_parameters(rows: int, seed: int = 0) -> Parameters:
    return from_gaussians(random_gaussians(rows, 1, seed))


def joined(*parts: Gaussians) -> Gaussians:
    return join_rows(parts)


def moved(g: Gaussians, rows: slice, by: tuple[float, float, float]) -> Gaussians:
    means = g.means.copy()
    means[rows] += np.array(by, np.float32)
    return replace(g, means=means)


def appeared(count: int = 40) -> Gaussians:
    ball = coloured_cloud(count, seed=9)
    means, colours = (0.3 * ball.means + BALL).astype(np.float32), np.full_like(ball.sh_dc, 1.5)
    return replace(ball, means=means, log_scales=ball.log_scales - 0.5, sh_dc=colours)


def views_of(g: Gaussians, cameras: list[Camera]) -> list[View]:
    return [View(c, Target(np.clip(render(g, c).rgb, 0, 1))) for c in cameras]


def windowed_ssim(a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
    """Mean SSIM (Wang et al. 2004) of pictures (H, W, 3) of float64 that are zero outside."""
    taps = torch.exp(-((torch.arange(11) - 5).double() ** 2) / 4.5)
    window = torch.outer(taps, taps)[None, None] / taps.sum() ** 2
    pictures = torch.stack([a, b, a * a, b * b, a * b]).permute(0, 3, 1, 2).flatten(0, 1)[:, None]
    blurred = torch.nn.functional.conv2d(pictures, window, padding=5).unflatten(0, (5, 3))
    mean_a, mean_b, square_a, square_b, product = blurred
    top = (2 * mean_a * mean_b + 1e-4) * (2 * (product - mean_a * mean_b) + 9e-4)
    squares = mean_a**2 + mean_b**2
    return (top / ((squares + 1e-4) * (square_a + square_b - squares + 9e-4))).mean()


def measure_usage(frames: Sequence[Gaussians], cameras: Sequence[Camera]) -> Usage:
    """Usage over some frames of one group, seen by all cameras."""
    return measure_views([(frame, camera) for frame in frames for camera in cameras])[0]
