"""A sequence cut into spatial tiles where its first frame has its rows, the same rows in all frames.

N rows, T tiles.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from airgs_codec.render.cpu import render
from airgs_codec.scene.camera import Camera
from airgs_codec.scene.gaussians import SH_C0, Gaussians
from airgs_codec.scene.morton import morton_encode
from airgs_codec.scene.ply import PlyHeader
from airgs_codec.scene.sequence import GaussianSequence

HALVES, MORTON = CUTS = ("halves", "morton")
BITS = 21  # of a grid index
INSIDE = 1.0  # per cent of the rows, at either end of an axis, that may lie outside of a tile's box
NEIGHBOURS = 8  # of a row, of which one in another tile makes it a row at a border
BORDER = 0.5  # share of a pixel's colour that rows at borders give, from which it is one of the band
COVERED = 0.5  # share of a pixel that Gaussians cover, from which it counts


@dataclass(frozen=True, slots=True, eq=False)
class Tile:
    """Some rows of a scene, and where they are."""

    rows: NDArray[np.int32]  # ascending
    low: NDArray[np.float64]  # (3,) corner of the box of their means over all frames, but for INSIDE of them
    high: NDArray[np.float64]  # (3,)


def split(sequence: GaussianSequence, count: int, cut: str = HALVES) -> list[Tile]:
    """Tiles of equally many rows, of a sequence that is one group; `cut` is one of CUTS."""
    frames = [sequence.read(t).means.astype(np.float64) for t in (0, len(sequence) // 2, len(sequence) - 1)]
    tiles = []
    for part in in_halves(frames[0], count) if cut == HALVES else in_morton_order(frames[0], count):
        means = np.concatenate([means[part] for means in frames])
        corners = np.percentile(means, [INSIDE, 100 - INSIDE], axis=0)
        tiles.append(Tile(np.sort(part).astype(np.int32), *corners))
    return tiles


def in_morton_order(means: NDArray[np.float64], count: int) -> list[NDArray[np.intp]]:
    """Rows of each tile: ranges of their Morton order."""
    low, high = means.min(axis=0), means.max(axis=0)
    index = (means - low) / max(float((high - low).max()), 1e-9) * ((1 << BITS) - 1)
    return np.array_split(np.argsort(morton_encode(index.astype(np.int64)), kind="stable"), count)


def in_halves(means: NDArray[np.float64], count: int) -> list[NDArray[np.intp]]:
    """Rows of each tile: boxes that are halved across their longest side, again and again."""

    def halve(rows: NDArray[np.intp], tiles: int) -> list[NDArray[np.intp]]:
        if tiles == 1:
            return [rows]
        low, high = np.percentile(means[rows], [INSIDE, 100 - INSIDE], axis=0)
        order = rows[np.argsort(means[rows, int(np.argmax(high - low))], kind="stable")]
        few = tiles // 2
        at = len(rows) * few // tiles
        return halve(order[:at], few) + halve(order[at:], tiles - few)

    return halve(np.arange(len(means)), count)


def restricted(sequence: GaussianSequence, tile: Tile) -> GaussianSequence:
    """The sequence with the rows of a tile alone."""
    headers = tuple(PlyHeader(len(tile.rows), header.sh_degree) for header in sequence.headers)
    return replace(sequence, headers=headers, orders=dict.fromkeys(range(len(sequence)), tile.rows))


def joined(parts: Sequence[Gaussians]) -> Gaussians:
    """All rows, one part after the other."""
    return Gaussians(*(np.concatenate([getattr(part, f.name) for part in parts]) for f in fields(Gaussians)))


def border_rows(frame: Gaussians, tiles: Sequence[Tile]) -> NDArray[np.bool_]:
    """(N,) rows one of whose nearest neighbours is in another tile."""
    of_row = np.empty(len(frame), np.int32)
    for number, tile in enumerate(tiles):
        of_row[tile.rows] = number
    _, near = cKDTree(frame.means).query(frame.means, NEIGHBOURS + 1)
    return np.any(of_row[near] != of_row[:, None], axis=1)


def border_pixels(frame: Gaussians, border: NDArray[np.bool_], camera: Camera) -> tuple[NDArray[np.bool_], ...]:
    """(H, W) pixels that show mostly rows at borders, and covered pixels that show mostly others."""
    white = np.repeat(border[:, None], 3, axis=1).astype(np.float32)
    marked = replace(frame, sh_dc=(white - 0.5) / np.float32(SH_C0), sh_rest=frame.sh_rest[:, :0])
    picture = render(marked, replace(camera, background=(0.0, 0.0, 0.0)))
    cover = 1 - picture.transmittance
    share, covered = picture.rgb[..., 0] / np.maximum(cover, 1e-6), cover > COVERED
    return covered & (share > BORDER), covered & (share <= BORDER)
