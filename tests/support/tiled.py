"""Small manifests of scenes in tiles, and viewers who turn, for tests of the player."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from airgs_codec.package import tables as mf
from airgs_codec.package.manifest import Manifest
from airgs_codec.scene.camera import Camera, look_at
from tests.support.manifests import in_groups, tiny_manifest

AWAY, HALF = 10.0, 1.0  # of the middle of a tile from the viewer; half a side of its box


def tiled_manifest(tiles: int = 4, parts: int = 2, empty: Sequence[int] = (), **options: Any) -> Manifest:
    """The manifest of `tiny_manifest(**options)` in a ring of tiles about the origin, tile 0 in the direction of z.

    Each tile has all that its only tile has: so do the files. Every segment is cut into `parts`. Tiles that are `empty`
    have no rows.
    """
    m = tiny_manifest(**options)
    groups = []
    for group in m.groups:
        (only,) = group.tiles
        found = [_tile(only, 2 * np.pi * p / tiles, p in empty) for p in range(tiles)]
        spans = np.linspace(group.start, group.stop, parts + 1).astype(int).tolist()
        segments = [
            mf.Segment(start, stop, [_level(level, tiles, stop - start, empty) for level in group.segments[0].levels])
            for start, stop in pairwise(spans)
        ]
        count = sum(tier.count for tile in found for tier in tile.tiers)
        groups.append(replace(group, tiles=found, segments=segments, count=count))
    return replace(m, tiles=tiles, groups=in_groups(groups, options.get("table_bytes", 100)))


def _tile(only: mf.GroupTile, angle: float, empty: bool) -> mf.GroupTile:
    middle = AWAY * np.array([np.sin(angle), 0.0, np.cos(angle)])
    if not empty:
        return replace(only, low=(middle - HALF).tolist(), high=(middle + HALF).tolist())
    nothing = [
        replace(tier, count=0, sidecar=mf.NO_FILE, pictures=[mf.NO_FILE] * len(tier.pictures)) for tier in only.tiers
    ]
    return replace(only, low=[0.0] * 3, high=[0.0] * 3, tiers=nothing)


def _level(level: mf.SegmentLevel, tiles: int, frames: int, empty: Sequence[int]) -> mf.SegmentLevel:
    file, sizes = level.files[0], level.frame_bytes[0][:frames]
    has = [p not in empty for p in range(tiles)]
    return replace(
        level,
        files=[file if there else mf.NO_FILE for there in has],
        frame_bytes=[list(sizes) if there else [] for there in has],
    )


@dataclass(frozen=True)
class Turning:
    """A viewer at the origin, with a picture of 60 degrees, who looks at tile 0 and turns from a moment on."""

    degrees: float = 0.0  # a second, towards the next tile
    since: float = 0.0  # seconds after the first picture
    until: float = 1e9

    def at(self, seconds: float) -> Camera:
        """His picture."""
        angle = np.radians(self.degrees * float(np.clip(seconds - self.since, 0.0, self.until - self.since)))
        ahead = np.array([np.sin(angle), 0.0, np.cos(angle)])
        return look_at(np.zeros(3), ahead, np.array([0.0, 1.0, 0.0]), size=100, fov_y=np.pi / 3, name="")
