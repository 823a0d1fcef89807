"""Arguments of public functions: a path stands for what it opens, and what is of no use is refused in one line."""

from __future__ import annotations

import reprlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

from airgs_codec.errors import ConfigError

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


def described(value: object) -> str:
    """A value for people: its type and, shortened, what it is."""
    return "None" if value is None else f"{type(value).__name__} {' '.join(reprlib.repr(value).split())}"
