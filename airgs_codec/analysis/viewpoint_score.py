"""How well a scene looks from a place: how much of a picture is made of Gaussians that are small in it.

From where a scene was filmed, surfaces are made of many small Gaussians, and there is something behind every pixel;
from elsewhere one sees needles, backs of walls, and what floats before a lens. n rows of a sample, H x W pixels.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from airgs_codec.errors import SceneError
from airgs_codec.render import Camera, cpu
from airgs_codec.render.cpu import RasterInputs
from airgs_codec.scene.camera import BLACK
from airgs_codec.scene.gaussians import LARGEST, SH_C0, Gaussians, to_matrices

Floats = NDArray[np.float32]

ANGLES = np.radians([2.5, 1.0])  # a Gaussian of this standard deviation, seen from the camera, counts 1 / e
VISIBLE = 0.01  # opacity; rows below it are passed over
EMPTY = 4  # power of the covered share: a picture with a hole of a quarter counts a third
SOLID = 0.9  # opacity of a pixel
PART = np.radians(6)  # of an object that fills a picture, rather than of its surroundings
HALF = 0.5  # opacity of a pixel that has a depth
ROUGH = 0.2  # counts 1 / e
AHEAD = 0.7  # cosine
WIDEST = 1e9  # world units; what is larger or further squares to more than float32 holds
LEAST = 1e-12  # avoids 0 / 0 where nothing is drawn


@dataclass(frozen=True, slots=True)
class Look:
    """The looks of a sample of the rows from one camera."""

    surface: float  # share of the picture that is explained by Gaussians that are small in it and flat
    covered: float  # share of the picture that Gaussians cover
    rough: float  # how much the logarithm of depth changes from pixel to pixel, on average
    distance: float  # world units: geometric mean of the distances of the rows in the picture

    @staticmethod
    def mean(looks: Sequence[Look]) -> Look:
        """The mean of each figure."""
        return Look(*(float(np.mean([getattr(look, f.name) for look in looks])) for f in fields(Look)))

    @property
    def score(self) -> float:
        """0..1; holes and splintered depth count heavily."""
        return self.surface * self.covered**EMPTY * float(np.exp(-self.rough / ROUGH))


@dataclass(frozen=True, slots=True, eq=False)
class Sample:
    """Some rows of a frame, chosen by how much they can cover, and grown for those that were not chosen."""

    inputs: RasterInputs[Floats]
    covariances: Floats  # (n, 6) xx, yy, zz, 2 xy, 2 xz, 2 yz of the rows as they were
    flatness: Floats  # (n,) 0 for needles and balls, 1 for discs

    @staticmethod
    def of(gaussians: Gaussians, rows: int, seed: int = 0) -> Sample:
        """About `rows` of the frame's rows, which are finite and have quaternions of length 1.

        Raises SceneError when no row can be seen.
        """
        drawn = (np.abs(gaussians.means) < WIDEST).all(axis=1) & (gaussians.log_scales < np.log(WIDEST)).all(axis=1)
        visible = np.flatnonzero(drawn & (gaussians.opacities() > VISIBLE))
        if not visible.size:
            raise SceneError(f"expected a Gaussian with opacity above {VISIBLE}, got none in {len(gaussians)}")
        chances = _chances(np.sqrt(gaussians.areas()[visible]), rows)
        picked = np.random.default_rng(seed).random(len(visible)) < chances
        chosen = gaussians.take(visible[picked]).with_degree(0)
        growth = -0.5 * np.log(chances[picked])  # a row that stands for k rows has k times their area
        grown = replace(chosen, log_scales=(chosen.log_scales + growth[:, None]).astype(np.float32))
        return Sample(cpu.activate(grown), _covariances(chosen), flatness(chosen))

    def look(self, camera: Camera) -> Look:
        """Return what `camera` sees."""
        sizes, distances = self._angles(camera)
        worth = self.flatness * np.exp(-sizes[:, None] / ANGLES).mean(axis=1)
        depths = np.log(distances / distances.min())
        surface, depth, alpha = self._draw(camera, worth, depths)
        rough = _roughness(np.divide(depth, np.maximum(alpha, LEAST), dtype=np.float32), alpha > HALF)
        return Look(float(surface.mean()), float(alpha.mean()), rough, self._distance(camera, distances))

    def solidity(self, camera: Camera) -> float:
        """Share of pixels that are opaque and explained by small Gaussians, of what is covered; 0 where nothing is."""
        small = np.exp(-self._angles(camera)[0] / PART)
        part, _, alpha = self._draw(camera, small, small)
        return float(part[alpha > SOLID].sum()) / max(float(alpha.sum()), LEAST)

    def _draw(self, camera: Camera, a: Floats, b: Floats) -> tuple[Floats, Floats, Floats]:
        """(H, W) sums of two values of rows, at least 0, weighted as they are blended; and opacities."""
        sh = ((np.stack([a, b, b], axis=1)[:, None] - 0.5) / SH_C0).astype(np.float32)
        picture = cpu.blend(self.inputs._replace(sh=sh), camera, BLACK).picture
        return picture.rgb[..., 0], picture.rgb[..., 1], 1 - picture.transmittance

    def _distance(self, camera: Camera, distances: Floats) -> float:
        """Geometric mean of the distances of rows within half a right angle about the axis; of all if none is."""
        ahead = (self.inputs.means - camera.position.astype(np.float32)) @ camera.world_to_camera[2, :3]
        near = ahead > distances * AHEAD
        return float(np.exp(np.log(distances[near] if near.any() else distances).mean()))

    def _angles(self, camera: Camera) -> tuple[Floats, Floats]:
        """(n,) standard deviations across the line of sight in radians, and (n,) distances in world units."""
        to = self.inputs.means - camera.position.astype(np.float32)
        x, y, z = to.T
        squares = np.einsum("ni,ni->n", to, to) + np.float32(LEAST)
        products = np.stack([x * x, y * y, z * z, x * y, x * z, y * z], axis=1)
        along = np.einsum("ni,ni->n", self.covariances, products) / squares
        across = np.maximum(self.covariances[:, :3].sum(axis=1) - along, 0)
        return np.sqrt(across / squares), np.sqrt(squares)


def _chances(weights: NDArray[np.float64], rows: int) -> NDArray[np.float64]:
    """Chances in 0..1 in proportion to weights, as far as 1 allows, that choose about `rows` rows."""
    if rows >= len(weights):
        return np.ones(len(weights))
    chances = np.minimum(1, weights * rows / weights.sum())
    for _ in range(20):  # what is cut at 1 is dealt out to the others
        chances = np.minimum(1, chances * rows / chances.sum())
    return chances


def _roughness(depth: Floats, seen: NDArray[np.bool_]) -> float:
    """Mean absolute difference of (H, W) values between neighbours that are both seen, in rows plus in columns."""
    total = 0.0
    for a, b, both in (
        (depth[1:], depth[:-1], seen[1:] & seen[:-1]),
        (depth[:, 1:], depth[:, :-1], seen[:, 1:] & seen[:, :-1]),
    ):
        total += float(np.abs(a - b)[both].mean()) if both.any() else 0.0
    return total


def flatness(gaussians: Gaussians) -> Floats:
    """(N,) 0 for rows that are needles or balls, 1 for discs."""
    scales = np.sort(gaussians.log_scales, axis=1)
    return (1 - np.exp(scales[:, 0] - scales[:, 1])) ** 2


def _covariances(gaussians: Gaussians) -> Floats:
    scales = np.exp(np.minimum(gaussians.log_scales.astype(np.float64), LARGEST))
    axes = to_matrices(gaussians.quaternions) * scales[:, None, :]
    c = axes @ axes.transpose(0, 2, 1)
    columns = (c[:, 0, 0], c[:, 1, 1], c[:, 2, 2], 2 * c[:, 0, 1], 2 * c[:, 0, 2], 2 * c[:, 1, 2])
    return np.stack(columns, axis=1).astype(np.float32)
