"""Settings: dataclasses whose fields say what they mean, once, for docstrings and for the help texts of options."""

from __future__ import annotations

import inspect
import os
import textwrap
from collections.abc import Callable
from dataclasses import MISSING, Field, field, fields
from typing import Any, TypeVar

Settings = TypeVar("Settings")


def setting(default: Any, about: str) -> Any:
    """A field of settings with its default; `about` is a phrase that says what it means, with its unit."""
    return field(default=default, metadata={"about": about})


def computed_setting(default: Callable[[], Any], about: str) -> Any:
    """The same with a default that is computed when the settings are made."""
    return field(default_factory=default, metadata={"about": about})


def about(settings: type, name: str) -> str:
    """What the field `name` means. Raises KeyError for a name that is not a field."""
    return {f.name: f for f in fields(settings)}[name].metadata["about"]


def documented(settings: type[Settings]) -> type[Settings]:
    """The dataclass `settings`, its docstring followed by a paragraph for each field: name, default and meaning."""
    lines = (textwrap.fill(_line(f), 100, subsequent_indent="    ") for f in fields(settings))  # type: ignore[arg-type]
    settings.__doc__ = "\n".join([inspect.cleandoc(settings.__doc__ or ""), "", *lines])
    return settings


def _line(f: Field[Any]) -> str:
    default = "" if f.default is MISSING else f" = {f.default!r}"
    return f"{f.name}{default}: {f.metadata['about']}."


def available_cores() -> int:
    """Cores that this process may run on: fewer than the machine's where a scheduler has given it some."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
