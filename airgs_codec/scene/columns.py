"""Named arrays of which row n is the same thing: the base of Gaussians and of whatever else is known row by row."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

SHARED = {"shared": True}  # metadata of a field that is no column: it belongs to all rows
Rows = NDArray[np.integer] | NDArray[np.bool_] | slice


@dataclass(frozen=True, slots=True, eq=False)
class Columns:
    """A frozen dataclass whose fields are columns: arrays whose first axis is rows, or other Columns of as many rows.

    Fields declared as `field(metadata=SHARED)` belong to all rows; what is made of some rows has them unchanged.
    """

    def columns(self) -> dict[str, Any]:
        """The columns by name, in the order in which they are declared."""
        return {f.name: getattr(self, f.name) for f in fields(self) if not f.metadata}

    def __len__(self) -> int:
        return len(next(iter(self.columns().values())))

    def take(self, rows: Rows) -> Self:
        """The rows that an index array, a mask or a slice picks; a slice copies nothing."""
        columns = self.columns().items()
        return replace(self, **{name: c.take(rows) if isinstance(c, Columns) else c[rows] for name, c in columns})

    def chunks(self, size: int) -> Iterator[Self]:
        """All rows in order, at most `size` at a time."""
        return (self.take(slice(start, start + size)) for start in range(0, len(self), size))

    @classmethod
    def join(cls, parts: Sequence[Self]) -> Self:
        """The rows of all parts, at least one, one after another; shared fields are those of the first part."""
        every = [part.columns() for part in parts]
        joined = {
            name: column.join([c[name] for c in every]) if isinstance(column, Columns) else
            np.concatenate([c[name] for c in every])
            for name, column in every[0].items()
        }  # fmt: skip
        return replace(parts[0], **joined)
