"""The points of a COLMAP reconstruction, text or binary: points3D.{bin,txt}."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from airgs_codec.scene.cameras.posed import Cursor, expecting
from airgs_codec.train.data.multiview import Points

TRACK_BYTES = 8  # for each picture that saw a point


def read_points3d(model: Path) -> Points | None:
    """The cloud of points in the folder of a reconstruction; None where it has no file of them. Raises SceneError."""
    for name, rows in (("points3D.bin", _rows_of_binary), ("points3D.txt", _rows_of_text)):
        path = model / name
        if path.is_file():
            with expecting(path, "points of a COLMAP reconstruction"):
                table = np.array(list(rows(path)), np.float32).reshape(-1, 6)
            return Points(table[:, :3], table[:, 3:] / np.float32(255))
    return None


def _rows_of_binary(path: Path) -> Iterator[tuple[float, ...]]:
    """Position and colour of each point, colours 0..255."""
    cursor = Cursor.open(path)
    for _ in range(*cursor.take("Q")):
        _, x, y, z, red, green, blue, _, track = cursor.take("Q3d3BdQ")
        cursor.skip(TRACK_BYTES * track)
        yield x, y, z, red, green, blue


def _rows_of_text(path: Path) -> Iterator[tuple[float, ...]]:
    with path.open(encoding="utf-8") as file:
        for line in file:
            if line.strip() and not line.startswith("#"):
                x, y, z, red, green, blue = map(float, line.split(maxsplit=7)[1:7])
                yield x, y, z, red, green, blue
