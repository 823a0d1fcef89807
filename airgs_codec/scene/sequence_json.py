"""Reads and writes sequence.json beside the frames of a sequence: frame rate, first frames of groups, background."""

from __future__ import annotations

import json
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

from airgs_codec.errors import SceneError
from airgs_codec.places.whole import write_json
from airgs_codec.scene.camera import BLACK, Background

DEFAULT_FPS = Fraction(30)
MAX_FPS = 1000
SETTINGS_NAME = "sequence.json"
Settings = tuple[Fraction, tuple[int, ...] | None, Background]  # frames a second, keyframes, colour behind the scene
DEFAULTS: Settings = (DEFAULT_FPS, None, BLACK)


def read_settings(folder: Path, frames: int) -> Settings:
    """Return what the sequence.json of a folder with so many frames says, or the defaults. Raises SceneError."""
    path = folder / SETTINGS_NAME
    if not path.exists():
        return DEFAULTS
    try:
        data: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        fps = exact_number(str(data.get("fps", DEFAULT_FPS)))
        keyframes = data.get("keyframes")
        starts = None if keyframes is None else tuple(sorted({0, *(int(k) for k in keyframes)}))
    except (OSError, ValueError, TypeError, AttributeError, ZeroDivisionError) as error:
        raise SceneError(f'{path}: expected {{"fps": number, "keyframes": [frame, ...]}}, got {error}') from error
    if starts and not (starts[0] >= 0 and starts[-1] < frames):
        raise SceneError(f"{path}: expected keyframes in 0..{frames - 1}, got {list(starts)}")
    return frame_rate(str(path), fps), starts, _background(path, data.get("background", BLACK))


def write_settings(
    folder: Path, fps: Fraction, keyframes: Sequence[int] | None = None, background: Background = BLACK
) -> None:
    """Write it, atomically; without keyframes and a black background nothing is said of these."""
    exact = Fraction(str(float(fps))) == fps
    settings: dict[str, Any] = {"fps": float(fps) if exact else str(fps)}
    settings |= {} if keyframes is None else {"keyframes": list(keyframes)}
    settings |= {} if background == BLACK else {"background": list(background)}
    write_json(folder / SETTINGS_NAME, settings)


def _background(path: Path, data: Any) -> Background:
    numbers = data if isinstance(data, (list, tuple)) else ()
    if len(numbers) == 3 and all(type(value) in (int, float) and 0 <= value <= 1 for value in numbers):
        r, g, b = map(float, numbers)
        return r, g, b
    raise SceneError(f"{path}: expected a background of r, g, b from 0 to 1, got {data}")


def exact_number(text: str) -> Fraction:
    """A number: 30, 29.97 or 30000/1001. Raises ValueError or ZeroDivisionError.

    Powers of ten go through float64 and end at its largest: Fraction would write out all digits of 1e30000000.
    """
    return Fraction(text) if "/" in text else Fraction(str(float(text)))


def frame_rate(where: str, fps: Fraction | float) -> Fraction:
    """Frames a second, exactly. Raises SceneError where they are not above 0 and at most MAX_FPS."""
    if not 0 < fps <= MAX_FPS:
        raise SceneError(f"{where}: expected 0 < fps <= {MAX_FPS}, got {fps}")
    return Fraction(str(fps))  # 29.97 is 2997/100, not the nearest float
