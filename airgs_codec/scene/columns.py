"""Named arrays of which row n is the same thing: the base of Gaussians and of whatever else is known row by row."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

SHARED = {"shared": True}  # metadata of a field that is no column: it belongs to all rows
Rows = NDArray[np.integer] | NDArray[np.bool_] | slice


@dataclass(frozen=True, slots=True, eq=False)
class Columns:
    """A frozen dataclass of columns: arrays whose first axis is rows, Columns of as many rows, or lists of either.

    The first column is no list. Fields declared as `field(metadata=SHARED)` belong to all rows; what is made of some
    rows has them unchanged.
    """

    def columns(self) -> dict[str, Any]:
        return {f.name: getattr(self, f.name) for f in fields(self) if not f.metadata}

    def __len__(self) -> int:
        return len(next(iter(self.columns().values())))

    @property
    def nbytes(self) -> int:
        return sum(getattr(column, "nbytes", 0) for column in self.columns().values())

    def take(self, rows: Rows) -> Self:
        """Return the rows that an index array, a mask or a slice picks; a slice copies nothing."""
        return self.combined([self], lambda same: same[0][rows])

    @classmethod
    def join(cls, parts: Sequence[Self]) -> Self:
        return cls.combined(parts, np.concatenate)

    @classmethod
    def combined(cls, parts: Sequence[Self], combine: Callable[[list[Any]], NDArray[Any]]) -> Self:
        """Combine the columns of each name of all parts, at least one; what is shared is that of the first."""

        def one(same: list[Any]) -> Any:
            if isinstance(same[0], Columns):
                return type(same[0]).combined(same, combine)
            return [one(list(of)) for of in zip(*same, strict=True)] if isinstance(same[0], list) else combine(same)

        every = [part.columns() for part in parts]
        return replace(parts[0], **{name: one([columns[name] for columns in every]) for name in every[0]})
