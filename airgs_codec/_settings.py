"""Settings: dataclasses whose fields say what they mean, once, for docstrings and for the help texts of options."""

from __future__ import annotations

import inspect
import os
import textwrap
from collections.abc import Callable
from dataclasses import MISSING, Field, field, fields, is_dataclass, replace
from typing import Any, TypeVar

Settings = TypeVar("Settings")


def setting(default: Any, about: str, /, **more: Any) -> Any:
    """Returns a field of settings with its default; `about` is a phrase that says what it means, with its unit.

    `more`: what `airgs_codec.cli.options` has to know to make an option of it: `choices`, or `read`, a function from
    text; `metavar`; `default`, the default in words; `short`, as -o; `topic`, if it is no everyday option.
    """
    return field(default=default, metadata={"help": about, **more})


def computed_setting(default: Callable[[], Any], about: str, /, **more: Any) -> Any:
    """Returns the same with a default that is computed when the settings are made."""
    return field(default_factory=default, metadata={"help": about, **more})


def required(about: str, **more: Any) -> Any:
    """Returns a field without a default, which must be given."""
    return field(metadata={"help": about, **more})


def about(settings: type, name: str) -> str:
    """Returns what the field `name` means. Raises KeyError for a name that is not a field."""
    return {f.name: f for f in fields(settings)}[name].metadata["help"]


def default_of(one: Field[Any]) -> Any:
    """Returns the default of a field, MISSING where it has none."""
    return one.default if one.default_factory is MISSING else one.default_factory()


def applied(settings: Settings, given: dict[str, Any]) -> Settings:
    """Returns the settings with the fields that were given; a dictionary is applied to the settings in its field."""
    changes = {}
    for name, value in given.items():
        before = getattr(settings, name)
        nested = isinstance(value, dict) and is_dataclass(before)
        changes[name] = applied(before, value) if nested else value
    return replace(settings, **changes)  # type: ignore[type-var]


def documented(settings: type[Settings]) -> type[Settings]:
    """Returns the dataclass `settings`, its docstring followed by a paragraph a field: name, default and meaning."""
    lines = (textwrap.fill(_line(f), 100, subsequent_indent="    ") for f in fields(settings))  # type: ignore[arg-type]
    settings.__doc__ = "\n".join([inspect.cleandoc(settings.__doc__ or ""), "", *lines])
    return settings


def _line(f: Field[Any]) -> str:
    default = "" if f.default is MISSING else f" = {f.default!r}"
    return f"{f.name}{default}: {f.metadata['help']}."


def available_cores() -> int:
    """Returns the cores that this process may run on: fewer than the machine's where a scheduler has given it some."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
