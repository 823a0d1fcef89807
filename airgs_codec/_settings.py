"""Settings: dataclasses whose fields say what they mean, once, for docstrings and for the help texts of options."""

from __future__ import annotations

import inspect
import os
import textwrap
from dataclasses import MISSING, Field, field, fields
from numbers import Integral, Real
from typing import Any, TypeVar, get_args, get_origin, get_type_hints

from airgs_codec._arguments import described
from airgs_codec.errors import ConfigError

MOST = 1 << 31  # of whole numbers
KINDS = {float: "a number", int: "a whole number", str: "text", bool: "True or False", type(None): "None"}
Settings = TypeVar("Settings")


def setting(default: Any, about: str, /, **more: Any) -> Any:
    """Return a field of settings with its default, or a function that makes one; `about` says what it is, in what unit.

    `more`, of the option that is made of it: arguments of `cyclopts.Parameter` (choices, metavar, name, alias,
    validator); `read`, a function from text; `default`, in words; `topic`, unless it is an everyday option; `option`:
    False for none.
    """
    given: Any = {"default_factory" if callable(default) else "default": default}
    return field(**given, metadata={"help": about, **more})


def required(about: str, **more: Any) -> Any:
    """Return a field without a default, which must be given."""
    return field(kw_only="alias" in more, metadata={"help": about, **more})


def default_of(one: Field[Any]) -> Any:
    """Return the default of a field, MISSING where it has none."""
    return one.default if one.default_factory is MISSING else one.default_factory()


def documented(settings: type[Settings]) -> type[Settings]:
    """Return the dataclass `settings`, its docstring followed by a paragraph a field: name, default and meaning.

    Values of another kind than a field has are refused with a ConfigError that names it, when settings are made.
    """
    defaults = {f.name: "" if f.default is MISSING else f" = {f.default!r}" for f in fields(settings)}  # type: ignore[arg-type]
    lines = (f"{f.name}{defaults[f.name]}: {f.metadata['help']}." for f in fields(settings))  # type: ignore[arg-type]
    paragraphs = (textwrap.fill(line, 100, subsequent_indent="    ") for line in lines)
    settings.__doc__ = "\n".join([inspect.cleandoc(settings.__doc__ or ""), "", *paragraphs])
    check = getattr(settings, "__post_init__", lambda self: None)

    def made(self: Settings) -> None:
        for name, kind in get_type_hints(settings).items():
            if not _is_of(getattr(self, name), kind):
                raise ConfigError(f"{name}: expected {_words_of(kind)}, got {described(getattr(self, name))}")
        for one in fields(settings):  # type: ignore[arg-type]
            choices, value = one.metadata.get("choices"), getattr(self, one.name)
            if choices and value not in choices:
                raise ConfigError(f"{one.name}: expected one of {', '.join(choices)}, got {value}")
        check(self)

    settings.__post_init__ = made  # type: ignore[attr-defined]
    return settings


def _is_of(value: Any, kind: Any) -> bool:
    """Return whether a value is of the kind that a field has; no whole number has more than 31 bits."""
    inner = get_args(kind)
    if get_origin(kind) is tuple:
        parts = inner[:1] * len(value) if inner[-1] is ... and isinstance(value, tuple | list) else inner
        return isinstance(value, tuple | list) and len(value) == len(parts) and all(map(_is_of, value, parts))
    if inner:
        return any(_is_of(value, one) for one in inner)
    if kind not in (int, float):
        return isinstance(value, kind)
    number = isinstance(value, Integral if kind is int else Real) and not isinstance(value, bool)
    return number and not (isinstance(value, Integral) and abs(int(value)) >= MOST)


def _words_of(kind: Any) -> str:
    if get_args(kind) and get_origin(kind) is not tuple:
        return " or ".join(_words_of(one) for one in get_args(kind))
    return KINDS.get(kind, "a tuple" if get_origin(kind) is tuple else kind.__name__)


def available_cores() -> int:
    """Return the number of cores that this process may run on: a scheduler may give it fewer than the machine has."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
