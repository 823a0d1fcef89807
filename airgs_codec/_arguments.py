"""Arguments of public functions: a path stands for what it opens, and other values are refused in one line."""

from __future__ import annotations

import reprlib
from collections.abc import Callable
from dataclasses import fields
from numbers import Integral
from pathlib import Path
from typing import Any, TypeVar

from airgs_codec.errors import ConfigError, FrameError

Kind = TypeVar("Kind")


def argument(
    name: str, value: object, kind: type[Kind], expected: str, opening: Callable[[Any], Kind] | None = None
) -> Kind:
    """Return the value of an argument: one of its kind as it is, of text or a path what `opening` makes of it.

    Raises ConfigError for any other, with the name of the argument and what was `expected`; and what `opening` raises.
    """
    if isinstance(value, kind):
        return value
    if opening is not None and isinstance(value, (str, Path)):
        return opening(value)
    raise ConfigError(f"{name}: expected {expected}, got {described(value)}")


def path_argument(name: str, value: str | Path) -> str | Path:
    """Return a path or an address. Raises ConfigError for anything else."""
    return value if isinstance(value, str) else argument(name, value, Path, "a path or an address")


def frame_argument(value: object, frames: int, least: int = 0) -> int:
    """Return the number of a frame; negative ones, down to `least`, count from the end. Raises FrameError."""
    if not (isinstance(value, Integral) and least <= int(value) < frames):
        raise FrameError(f"frame: expected {least}..{frames - 1}, got {value!r}")
    return int(value) % frames


def brief(value: Any) -> str:
    """Return a short `__repr__` of a dataclass: its arrays by their shape, numbers and texts unless default."""
    parts = []
    for one in (one for one in fields(value) if one.repr):
        found = getattr(value, one.name)
        if hasattr(found, "dtype") and found.ndim:
            parts.append(f"{one.name}=<{found.dtype} {found.shape}>")
        elif isinstance(found, int | float | str) and found != one.default:
            parts.append(f"{one.name}={found!r}")
    return f"{type(value).__name__}({', '.join(parts)})"


def described(value: object) -> str:
    """Return the type of a value and its shortened repr."""
    return "None" if value is None else f"{type(value).__name__} {' '.join(reprlib.repr(value).split())}"
