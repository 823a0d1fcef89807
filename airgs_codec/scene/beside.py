"""Other files in the folder of a sequence: sequence.json, usage.npz and ATTRIBUTION.txt.

sequence.json has the frame rate, the first frames of groups, the background, an origin and notes for people; usage.npz
how much each of the N Gaussians of a group contributes to the training views, as the trainer measured it: an array for
each group and measure, named "start:stop/measure".
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from numbers import Real
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from airgs_codec.errors import SceneError
from airgs_codec.places.whole import atomic_path, write_json
from airgs_codec.scene.camera import BLACK, Background
from airgs_codec.scene.columns import Columns
from airgs_codec.scene.files import expecting, read_object
from airgs_codec.scene.frames import ZERO, Origin

ATTRIBUTION_NAME = "ATTRIBUTION.txt"
USAGE_NAME = "usage.npz"
MOST_HEADER_BYTES = 1024  # of an array in it
MEASURES = ("importance", "max", "sum", "hits")  # the first is `analysis.importance`
DEFAULT_FPS = Fraction(30)
MIN_FPS, MAX_FPS = Fraction(1, 86_400), 1000
FINEST = 1_000_000  # largest denominator of a frame rate: clocks of MP4 have 32 bits
SETTINGS_NAME = "sequence.json"


@dataclass(frozen=True, slots=True)
class Settings:
    fps: Fraction = DEFAULT_FPS  # frames a second
    keyframes: tuple[int, ...] | None = None  # first frames of groups
    background: Background = BLACK  # colour behind the scene
    notes: tuple[str, ...] = ()  # what people should know of the sequence, a sentence each; packages repeat them
    origin: Origin = ZERO  # what to add to positions of frames; those of cameras need nothing


def read_settings(folder: Path, frames: int) -> Settings:
    """Return what the sequence.json of a folder of `frames` frames says, or the defaults. Raises SceneError."""
    path = folder / SETTINGS_NAME
    if not path.exists():
        return Settings()
    with expecting(path, '{"fps": number, "keyframes": [frame, ...]}'):
        data = read_object(path)
        fps = exact_number(str(data.get("fps", DEFAULT_FPS)))
        keyframes = data.get("keyframes")
        starts = None if keyframes is None else tuple(sorted({0, *(int(k) for k in keyframes)}))
        notes, (x, y, z) = tuple(data.get("notes", ())), map(float, data.get("origin", ZERO))
        if not (all(isinstance(note, str) for note in notes) and np.isfinite((x, y, z)).all()):
            raise ValueError(f"notes that are no texts, or an origin of {x}, {y}, {z}")
        if starts and not (starts[0] >= 0 and starts[-1] < frames):
            raise SceneError(f"{path}: expected keyframes in 0..{frames - 1}, got {starts[0]} to {starts[-1]}")
        colour = data.get("background", BLACK)
        numbers = colour if isinstance(colour, list | tuple) and len(colour) == 3 else [np.nan]
        if not all(type(value) in (int, float) and 0 <= value <= 1 for value in numbers):
            raise SceneError(f"{path}: expected a background of r, g, b from 0 to 1, got {colour}")
        r, g, b = map(float, numbers)
    return Settings(frame_rate(str(path), fps), starts, (r, g, b), notes, (x, y, z))


def write_settings(folder: Path, settings: Settings) -> None:
    """Write sequence.json, atomically: the frame rate, and what differs from the defaults."""
    fps = settings.fps
    said: dict[str, Any] = {"fps": float(fps) if Fraction(str(float(fps))) == fps else str(fps)}
    for name in ("keyframes", "background", "origin", "notes"):
        if (value := getattr(settings, name)) != getattr(Settings(), name):
            said[name] = list(value)
    write_json(folder / SETTINGS_NAME, said)


def exact_number(text: str) -> Fraction:
    """Return 30, 29.97 or 30000/1001 as a fraction; floats go through float64. Raises ValueError, ZeroDivisionError."""
    return Fraction(text) if "/" in text else Fraction(str(float(text)))


def frame_rate(where: str, fps: Fraction | float) -> Fraction:
    """Return frames a second with a denominator up to FINEST. Raises SceneError outside of a frame a day to MAX_FPS."""
    if not (isinstance(fps, Real) and MIN_FPS <= fps <= MAX_FPS):
        raise SceneError(f"{where}: expected 0 < fps <= {MAX_FPS}, at least a frame a day, got {fps}")
    return Fraction(str(fps)).limit_denominator(FINEST)  # 29.97 is 2997/100, not the nearest float


@dataclass(frozen=True, slots=True, eq=False)
class Usage(Columns):
    """Blending weights alpha T of each Gaussian over all pixels, views and frames that were measured (AirGS)."""

    total: NDArray[np.float64]  # (N,) sum of alpha T
    peak: NDArray[np.float64]  # (N,) max of alpha T, 0..1
    hits: NDArray[np.int64]  # (N,) pixels where it is blended: the paper's usage frequency, literally

    def measure(self, name: str) -> NDArray[np.float64]:
        """Return the measure (N,) of a name: max, sum or hits."""
        return {"max": self.peak, "sum": self.total, "hits": self.hits.astype(np.float64)}[name]


def save_usage(path: Path, groups: Mapping[tuple[int, int], Usage]) -> None:
    """Write the usage of groups, given by their frames (start, stop), as .npz, whole or not at all."""
    named = (((*span, name), column) for span, usage in groups.items() for name, column in usage.columns().items())
    arrays = {f"{start}:{stop}/{name}": column for (start, stop, name), column in named}
    with atomic_path(path) as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, allow_pickle=False, **arrays)


def load_usage(path: Path, start: int, stop: int, count: int) -> Usage | None:
    """Return the usage of a group of `count` rows; None when the file has no such group.

    Raises SceneError when the file is not one that `save_usage` wrote, or has more rows: they are not unpacked.
    """
    with expecting(path, "usage as the trainer writes it"), np.load(path, allow_pickle=False) as file:
        names = [f"{start}:{stop}/{name}" for name in Usage.__slots__]
        if names[0] not in file:
            return None
        for key in names:
            if (size := file.zip.getinfo(f"{key}.npy").file_size) > MOST_HEADER_BYTES + 8 * count:
                raise ValueError(f"{count} rows of 8 bytes, got {size} bytes of {key}")
        return Usage(*(file[key] for key in names))


def read_attribution(folder: Path) -> str:
    """Return the text of ATTRIBUTION.txt in a folder, empty without the file. Raises SceneError."""
    file = folder / ATTRIBUTION_NAME
    with expecting(file, "UTF-8 text"):
        return file.read_text(encoding="utf-8-sig").strip() if file.is_file() else ""
