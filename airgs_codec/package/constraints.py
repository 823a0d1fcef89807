"""What a value of the tables may be, beside its type: annotations that the strict reader and the JSON Schema share.

A constraint stands in `Annotated[type, constraint]`. `refusal` says what is wrong with a value, `schema` the same in
the keywords of JSON Schema. What ties one field to another is in `references`.
"""

from __future__ import annotations

import re
import types
import typing
from collections.abc import Sized
from dataclasses import dataclass
from typing import Any, Protocol


class Constraint(Protocol):
    """What the annotations have in common."""

    @property
    def reason(self) -> str:
        """The word of FORMAT.md's table of refusals that a value is refused for."""

    def refusal(self, value: Any) -> str | None:
        """What was expected and what came; None for a value that may stand."""

    def schema(self) -> dict[str, Any]:
        """Keywords of JSON Schema, to stand beside those of the type."""


@dataclass(frozen=True, slots=True)
class Range:
    """A number from `low` to `high`, both included."""

    low: float
    high: float
    reason: str = "bad_value"

    def refusal(self, value: float) -> str | None:
        """See Constraint."""
        return None if self.low <= value <= self.high else f"expected {self.low} to {self.high}, got {value}"

    def schema(self) -> dict[str, Any]:
        """See Constraint."""
        return {"minimum": self.low, "maximum": self.high}


@dataclass(frozen=True, slots=True)
class Length:
    """A list of at least `low` and at most `high` values."""

    low: int
    high: int
    reason: str = "bad_value"

    def refusal(self, value: Sized) -> str | None:
        """See Constraint."""
        fits = self.low <= len(value) <= self.high
        return None if fits else f"expected {self.low} to {self.high} values, got {len(value)}"

    def schema(self) -> dict[str, Any]:
        """See Constraint."""
        return {"minItems": self.low, "maxItems": self.high}


@dataclass(frozen=True, slots=True)
class OneOf:
    """One of some words."""

    words: tuple[str, ...]
    reason: str = "bad_value"

    def refusal(self, value: str) -> str | None:
        """See Constraint."""
        return None if value in self.words else f"expected one of {', '.join(self.words)}, got {value!r}"

    def schema(self) -> dict[str, Any]:
        """See Constraint."""
        return {"enum": list(self.words)}


@dataclass(frozen=True, slots=True)
class Pattern:
    """A text that a regular expression matches from its start to its end."""

    expression: str
    what: str  # such texts are, for people
    reason: str = "bad_value"

    def refusal(self, value: str) -> str | None:
        """See Constraint."""
        return None if re.fullmatch(self.expression, value) else f"expected {self.what}, got {value!r}"

    def schema(self) -> dict[str, Any]:
        """See Constraint."""
        return {"pattern": f"^(?:{self.expression})$"}


def as_required(hint: Any) -> Any:
    """T for the type T | None of a field that may be missing; any other type as it is."""
    if typing.get_origin(hint) not in (types.UnionType, typing.Union):
        return hint
    (kind,) = (argument for argument in typing.get_args(hint) if argument is not type(None))
    return kind
