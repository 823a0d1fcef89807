"""Where a picture shows Gaussians beside which the next tile begins."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from airgs_codec.render.cpu import render
from airgs_codec.scene.camera import Camera
from airgs_codec.scene.gaussians import SH_C0, Gaussians, join_rows

NEIGHBOURS = 8  # of a row, of which one in another tile makes it a row at a border
BORDER = 0.5  # share of a pixel's colour that rows at borders give, from which it is one of the band
COVERED = 0.5  # share of a pixel that Gaussians cover, from which it counts


def border_rows(tiles: Sequence[Gaussians]) -> NDArray[np.bool_]:
    """(N,) rows of all tiles, one after another, one of whose nearest neighbours is in another tile."""
    of_row = np.repeat(np.arange(len(tiles)), [len(tile) for tile in tiles])
    means = join_rows(tiles).means
    _, near = cKDTree(means).query(means, NEIGHBOURS + 1)
    return np.any(of_row[near] != of_row[:, None], axis=1)


def border_pixels(tiles: Sequence[Gaussians], border: NDArray[np.bool_], camera: Camera) -> list[NDArray[np.bool_]]:
    """(H, W) pixels that show mostly rows at borders, and covered pixels that show mostly others."""
    frame = join_rows(tiles)
    white = np.repeat(border[:, None], 3, axis=1).astype(np.float32)
    marked = replace(frame, sh_dc=(white - 0.5) / np.float32(SH_C0), sh_rest=frame.sh_rest[:, :0])
    picture = render(marked, replace(camera, background=(0.0, 0.0, 0.0)))
    cover = 1 - picture.transmittance
    share, covered = picture.rgb[..., 0] / np.maximum(cover, 1e-6), cover > COVERED
    return [covered & (share > BORDER), covered & (share <= BORDER)]
