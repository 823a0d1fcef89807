"""Options of the command line out of a frozen dataclass, as `airgs_codec._settings` describes its fields.

A field without a default is an argument by its place, another one is `--its-name`. A field may be a bool (a switch),
a str, int, float, Path or Fraction, one of these or None, or a tuple of one of these, which takes several values.
"""

from __future__ import annotations

import argparse
import ast
import types
from collections.abc import Sequence
from dataclasses import MISSING, Field, field, fields, replace
from fractions import Fraction
from pathlib import Path
from typing import Any, TypeVar, get_args, get_origin, get_type_hints

from airgs_codec._settings import setting
from airgs_codec.errors import ConfigError

__all__ = ["add_options", "expect_names", "read_options", "required", "setting", "with_fields"]

Options = TypeVar("Options")


def required(about: str) -> Any:
    """A field that must be given; `about` says what it means."""
    return field(metadata={"about": about})


def add_options(parser: argparse.ArgumentParser, options: type) -> None:
    """Add what a dataclass asks for to a parser."""
    hints = get_type_hints(options)
    for one in fields(options):
        parser.add_argument(*_words(one), **_properties(one, hints[one.name]))


def read_options(options: type[Options], args: argparse.Namespace) -> Options:
    """The dataclass of what was parsed."""
    given = {one.name: getattr(args, one.name) for one in fields(options)}  # type: ignore[arg-type]
    return options(**{name: tuple(value) if isinstance(value, list) else value for name, value in given.items()})


def _words(one: Field[Any]) -> list[str]:
    return [one.name] if _is_required(one) else [f"--{one.name.replace('_', '-')}"]


def _is_required(one: Field[Any]) -> bool:
    return one.default is MISSING and one.default_factory is MISSING


def _properties(one: Field[Any], hint: Any) -> dict[str, Any]:
    about = one.metadata["about"].replace("%", "%%")
    if hint is bool:
        return {"action": "store_true", "help": about}
    several = get_origin(hint) is tuple
    kind = get_args(hint)[0] if several else _without_none(hint)
    found: dict[str, Any] = {"type": kind, "help": about} | ({"nargs": "+"} if several else {})
    if _is_required(one):
        return found
    default = one.default if one.default_factory is MISSING else one.default_factory()
    return found | {"default": default, "metavar": _metavar(kind), "help": about + _default_words(default)}


def _without_none(hint: Any) -> Any:
    if get_origin(hint) is types.UnionType:
        return next(kind for kind in get_args(hint) if kind is not types.NoneType)
    return hint


def _metavar(kind: type) -> str:
    return {int: "N", float: "X", Fraction: "X", Path: "PATH"}.get(kind, "TEXT")


def _default_words(default: Any) -> str:
    if default in (None, "", ()):
        return ""
    shown = " ".join(map(str, default)) if isinstance(default, tuple) else str(default)
    return f" (default: {shown})".replace("%", "%%")


def expect_names(option: str, given: tuple[str, ...], known: tuple[str, ...]) -> None:
    """Raise ConfigError unless all of `given` are among `known`."""
    if unknown := [name for name in given if name not in known]:
        raise ConfigError(f"{option}: expected some of {', '.join(known)}, got {', '.join(unknown)}")


def with_fields(option: str, settings: Options, words: Sequence[str]) -> Options:
    """The dataclass with fields set from words such as group_frames=50, of the types they have. Raises ConfigError."""
    kinds = {one.name: str(one.type) for one in fields(settings)}  # type: ignore[arg-type]
    for word in words:
        name, _, text = word.partition("=")
        value = _read_value(text)
        if name not in kinds:
            raise ConfigError(f"{option} {word}: expected NAME=VALUE of {', '.join(kinds)}")
        if kinds[name] == "float" and type(value) is int:
            value = float(value)
        if type(value).__name__ not in kinds[name]:
            raise ConfigError(f"{option} {word}: expected {kinds[name]}, got {text!r}")
        settings = replace(settings, **{name: value})  # type: ignore[type-var]
    return settings


def _read_value(text: str) -> Any:
    """A Python literal; other text is itself."""
    try:
        return ast.literal_eval(text)
    except (ValueError, SyntaxError):
        return text
