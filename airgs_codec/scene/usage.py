"""Usage: how much each Gaussian contributes to the training views, as the trainer measured it and left it on disk.

N Gaussians of a group. usage.npz holds an array for each group and measure, named "start:stop/measure".
"""

from __future__ import annotations

import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from airgs_codec.errors import SceneError
from airgs_codec.places.whole import atomic_path

MEASURES = ("importance", "max", "sum", "hits")  # the first is `analysis.importance`


@dataclass(frozen=True, slots=True, eq=False)
class Usage:
    """Blending weights alpha T of each Gaussian over all pixels, views and frames that were measured (AirGS)."""

    total: NDArray[np.float64]  # (N,) sum of alpha T
    peak: NDArray[np.float64]  # (N,) max of alpha T, 0..1
    hits: NDArray[np.int64]  # (N,) pixels where it is blended: the paper's usage frequency, literally
    moved: NDArray[np.float64] | None = None  # (N,) max over frames of max alpha T x size of the change, in codec steps

    def measure(self, name: str) -> NDArray[np.float64]:
        """(N,) the measure of that name: max, sum or hits. Raises KeyError for any other."""
        return {"max": self.peak, "sum": self.total, "hits": self.hits.astype(np.float64)}[name]


def save_usage(path: Path, groups: Mapping[tuple[int, int], Usage]) -> None:
    """Write the usage of groups, given by their frames (start, stop), as .npz, whole or not at all."""
    arrays: dict[str, NDArray] = {}
    for (start, stop), usage in groups.items():
        columns = {"total": usage.total, "peak": usage.peak, "hits": usage.hits, "moved": usage.moved}
        arrays |= {f"{start}:{stop}/{name}": column for name, column in columns.items() if column is not None}
    with atomic_path(path) as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, allow_pickle=False, **arrays)


def load_usage(path: Path, start: int, stop: int) -> Usage | None:
    """Read the usage of the group of frames [start, stop); None when the file has no such group.

    Raises SceneError when the file is not one that `save_usage` wrote.
    """
    try:
        with path.open("rb") as opened, np.load(opened, allow_pickle=False) as file:
            names = {name: f"{start}:{stop}/{name}" for name in ("total", "peak", "hits", "moved")}
            return Usage(**{n: file[key] for n, key in names.items()}) if names["total"] in file else None
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise SceneError(f"{path}: expected usage as the trainer writes it: {error}") from error
