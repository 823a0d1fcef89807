"""Write manifests/vectors anew but for its README.md, a case on a line of its own.

What a case is given is read from the committed file, where new cases are added; what must come of it is made anew.
"""

from __future__ import annotations

import json

from tests.makers.vectors import packages, players, values, whole
from tests.support.paths import VECTORS
from tests.support.vectors import Table

OF_WHOLE_NUMBERS = whole.columns, whole.positions, whole.escapes, whole.planes
OF_VALUES = values.keyframes, values.deltas, values.shown, values.region


def write(table: Table) -> bytes:
    parts = []
    for name, cases in table.items():
        lines = ",\n".join("  " + json.dumps(case, separators=(",", ":"), allow_nan=False) for case in cases)
        parts.append(f" {json.dumps(name)}: [\n{lines}\n ]")
    return ("{\n" + ",\n".join(parts) + "\n}\n").encode()


def make() -> dict[str, bytes]:
    """File name -> bytes of all vectors; the same whenever and wherever it runs."""
    makers = *OF_WHOLE_NUMBERS, *OF_VALUES, players.policies, players.sessions
    parts = {f"{maker.__name__}.json": write(maker()) for maker in makers}
    table, frames = packages.tables()
    return parts | {"packages.json": write(table), "packages.bin": frames}


if __name__ == "__main__":
    for name, data in make().items():
        (VECTORS / name).write_bytes(data)
