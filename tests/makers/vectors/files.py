"""Which vectors there are, and their bytes.

What a case is given is read from the committed file, where new cases are added; what must come of it is made anew.
"""

from __future__ import annotations

from tests.makers.vectors import (
    columns,
    escapes,
    keys,
    packages,
    planes,
    policies,
    positions,
    region,
    sessions,
    shown,
    states,
)
from tests.makers.vectors.text import write

MODULES = (columns, positions, escapes, planes, keys, states, shown, region, policies, sessions)


def make() -> dict[str, bytes]:
    """File name -> bytes of all vectors; the same whenever and wherever it runs."""
    parts = {f"{module.__name__.rpartition('.')[2]}.json": write(module.table()) for module in MODULES}
    table, frames = packages.tables()
    return parts | {"packages.json": write(table), "packages.bin": frames}
