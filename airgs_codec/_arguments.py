"""Arguments of public functions: a path stands for what it opens, and what is of no use is refused in one line."""

from __future__ import annotations

import reprlib
from collections.abc import Callable, Sized
from dataclasses import fields
from numbers import Integral
from pathlib import Path
from typing import Any, TypeVar

from airgs_codec.errors import ConfigError, FrameError

SHOWN, LONGEST = 4, 120  # of a value in another: parts, characters
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
    if isinstance(value, (str, Path)):
        return value
    raise ConfigError(f"{name}: expected a path or an address, got {described(value)}")


def frame_argument(value: object, frames: int, least: int = 0) -> int:
    """Return the number of one of so many frames; from `least` up to 0, where it is below, they count from the end.

    Raises FrameError for anything else.
    """
    if not (isinstance(value, Integral) and least <= int(value) < frames):
        raise FrameError(f"frame: expected {least}..{frames - 1}, got {value!r}")
    return int(value) % frames


def brief(value: Any) -> str:
    """A dataclass for people, as its `__repr__`: what is not as by default, shortened, arrays by their shape."""
    shown = [(f, getattr(value, f.name)) for f in fields(value) if f.repr]
    changed = [(f.name, one) for f, one in shown if type(one) is not type(f.default) or one != f.default]
    return f"{type(value).__name__}({', '.join(f'{name}={_short(one)}' for name, one in changed)})"


def _short(value: Any) -> str:
    if hasattr(value, "dtype") and value.ndim:
        return f"<{value.dtype} {value.shape}>"
    if isinstance(value, Sized) and not isinstance(value, str) and len(value) > SHOWN:
        return f"<{type(value).__name__} of {len(value)}>"
    text = repr(value)
    return text if len(text) <= LONGEST and " object at 0x" not in text else f"<{type(value).__name__}>"


def described(value: object) -> str:
    """A value for people: its type and, shortened, what it is."""
    return "None" if value is None else f"{type(value).__name__} {' '.join(reprlib.repr(value).split())}"
