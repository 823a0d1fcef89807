"""A Spacetime-Gaussian scene: rows on cubic paths whose opacity comes and goes, and large ones before the lens.

Each row is drawn from a random model as of Spacetime Gaussians (Li et al., CVPR 2024): at time t its opacity is
peak * exp(-((t - t0) / w)^2), its mean a cubic polynomial of t - t0. N rows; times in 0..1 over the clip.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tests.faces import Camera, Gaussians, look_at
from tests.support.multiview_files import write_cameras
from tests.support.scenes import frozen, write_sequence
from tests.support.views import without_sh

STATIC_SHARE = 0.4  # of the rows: a floor and a wall, there all the time
FLASHES = 6  # large rows between content and lens, each seen in three or four frames
FLASH_FRAMES = 1.3  # their width w, in frames
FASTEST = 0.15  # widths below it do not make a row faster
HIDDEN = 1e-6  # opacity that .ply files of such scenes have for none
DISTANCE = 4.0  # of the cameras, world units; the moving content lies within about 1 of the origin
LOOK_FROM = (-0.5, 0.5), (0.05, 0.4)  # radians: azimuths and elevations of the cameras
UP = np.array([0.0, 1.0, 0.0])


@dataclass(frozen=True, slots=True, eq=False)
class TemporalRows:
    """What rows are at their centre in time, and how they change around it."""

    at_peak: Gaussians
    centres: NDArray[np.float64]  # (N,) t0
    widths: NDArray[np.float64]  # (N,) w
    motion: NDArray[np.float64]  # (3, N, 3) world units: factors of (t - t0), its square and its cube

    def at(self, time: float) -> Gaussians:
        since = time - self.centres
        powers = np.stack([since, since**2, since**3])
        means = self.at_peak.means + np.einsum("pn,pnx->nx", powers, self.motion)
        seen = self.at_peak.opacities() * np.exp(-((since / self.widths) ** 2))
        seen = np.clip(seen, HIDDEN, 1 - HIDDEN)
        logits = np.log(seen / (1 - seen))
        return frozen(replace(self.at_peak, means=f32(means), opacity_logits=f32(logits)))


def temporal_frames(count: int = 2000, frames: int = 24, seed: int = 0) -> list[Gaussians]:
    rng = np.random.default_rng(seed)
    still = int(STATIC_SHARE * count)
    rows = [_room(rng, still), _dancers(rng, count - still - FLASHES), _flashes(rng, frames)]
    joined = Gaussians(*(np.concatenate([getattr(r.at_peak, n) for r in rows]) for n in Gaussians.__slots__))
    centres, widths = (np.concatenate([getattr(r, n) for r in rows]) for n in ("centres", "widths"))
    clip = TemporalRows(joined, centres, widths, np.concatenate([r.motion for r in rows], axis=1))
    return [clip.at(t / max(frames - 1, 1)) for t in range(frames)]


def _room(rng: np.random.Generator, count: int) -> TemporalRows:
    across, along = rng.uniform(-4, 4, (2, count))
    floor = np.arange(count) % 2 == 0
    means = np.where(floor[:, None], np.stack([across, 0 * along - 1.2, along], 1), 0)
    means[~floor] = np.stack([across, 0.6 * along + 0.6, 0 * along - 2.5], 1)[~floor]
    size = 6.0 / np.sqrt(count)
    scales = np.where(floor[:, None], [size, 0.03, size], [size, size, 0.03])
    colours = np.sin(2.5 * means @ rng.normal(size=(3, 3))) * 0.8
    turns = np.concatenate([np.ones((count, 1)), rng.normal(size=(count, 3)) * 0.05], axis=1)
    looks = without_sh(means, turns, np.log(scales), np.full(count, 4.0), colours)
    return TemporalRows(looks, np.full(count, 0.5), np.full(count, 1e3), np.zeros((3, count, 3)))


def _dancers(rng: np.random.Generator, count: int) -> TemporalRows:
    """Rows that pass through the middle, most of them only for a part of the clip."""
    means = rng.normal(size=(count, 3)) * [0.5, 0.45, 0.4]
    widths = np.exp(rng.uniform(np.log(0.05), np.log(1.0), count))
    slow = np.maximum(widths, FASTEST)
    speeds = np.stack([0.10 / slow, 0.04 / slow**2, 0.02 / slow**3])
    motion = speeds[:, :, None] * rng.normal(size=(3, count, 3))
    size = np.log(0.5 / count ** (1 / 3)) + rng.normal(size=(count, 3)) * 0.5
    colours = np.sin(3 * means) + rng.normal(size=(count, 3)) * 0.25
    looks = without_sh(means, rng.normal(size=(count, 4)), size, rng.normal(2, 1, count), colours)
    return TemporalRows(looks, rng.uniform(-0.1, 1.1, count), widths, motion)


def _flashes(rng: np.random.Generator, frames: int) -> TemporalRows:
    """Large rows in front of the cameras, one after another, between the frames that a survey is likely to pick."""
    azimuths, rises = (rng.uniform(low, high, FLASHES) for low, high in LOOK_FROM)
    means = 0.7 * np.stack([place(a, r) for a, r in zip(azimuths, rises, strict=True)])
    size = np.log(0.22) + rng.normal(size=(FLASHES, 3)) * 0.2
    turns, colours = rng.normal(size=(FLASHES, 4)), rng.uniform(-1.5, 1.5, (FLASHES, 3))
    looks = without_sh(means, turns, size, np.full(FLASHES, 1.5), colours)
    centres = (np.arange(FLASHES) + 0.5) / FLASHES
    widths = np.full(FLASHES, FLASH_FRAMES / max(frames - 1, 1))
    motion = np.zeros((3, FLASHES, 3))
    motion[0] = rng.normal(size=(FLASHES, 3)) * 0.5
    return TemporalRows(looks, centres, widths, motion)


def f32(values: NDArray[np.float64]) -> NDArray[np.float32]:
    return np.asarray(values, np.float32)


def place(azimuth: float, elevation: float) -> NDArray[np.float64]:
    """(3,) where a camera stands that sees the origin under these angles, in radians."""
    flat = np.cos(elevation)
    return DISTANCE * np.array([np.sin(azimuth) * flat, np.sin(elevation), np.cos(azimuth) * flat])


def camera_at(azimuth: float, elevation: float, name: str, size: int) -> Camera:
    """A camera that looks at the origin, square pictures of `size` pixels."""
    return look_at(place(azimuth, elevation), np.zeros(3), UP, size=size, fov_y=0.75, name=name)


def temporal_cameras(size: int = 96) -> list[Camera]:
    """Twelve cameras for training and four held out, on the same part of a sphere."""
    azimuths, rises = np.linspace(*LOOK_FROM[0], 4), np.linspace(*LOOK_FROM[1], 3)
    train = [camera_at(a, r, f"train{i}{j}", size) for i, a in enumerate(azimuths) for j, r in enumerate(rises)]
    between = [(a, r) for a in np.linspace(*LOOK_FROM[0], 5)[1:4:2] for r in np.linspace(*LOOK_FROM[1], 5)[1:4:2]]
    return train + [replace(camera_at(a, r, f"test{i}", size), split="test") for i, (a, r) in enumerate(between)]


def write_temporal(folder: Path, count: int = 2000, frames: int = 24, size: int = 96) -> Path:
    """The clip and its cameras as a scene on disk, at 24 frames a second."""
    write_sequence(folder, temporal_frames(count, frames), cameras=False, fps=24)
    write_cameras(folder / "transforms.json", temporal_cameras(size))
    return folder
