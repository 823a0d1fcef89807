"""Write manifests/vectors anew but for its README.md.

What a case is given is read from the committed file, where new cases are added; what must come of it is made anew.
"""

from __future__ import annotations

from tests.makers.vectors import packages, players, region, values, whole
from tests.makers.vectors.text import write
from tests.support.paths import VECTORS

MADE = {
    "columns": whole.columns,
    "positions": whole.positions,
    "escapes": whole.escapes,
    "planes": whole.planes,
    "keys": values.keys,
    "states": values.states,
    "shown": values.shown,
    "region": region.table,
    "policies": players.policies,
    "sessions": players.sessions,
}


def make() -> dict[str, bytes]:
    """File name -> bytes of all vectors; the same whenever and wherever it runs."""
    parts = {f"{name}.json": write(table()) for name, table in MADE.items()}
    table, frames = packages.tables()
    return parts | {"packages.json": write(table), "packages.bin": frames}


if __name__ == "__main__":
    for name, data in make().items():
        (VECTORS / name).write_bytes(data)
