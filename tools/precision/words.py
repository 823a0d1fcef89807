"""How conclusions put figures."""

from __future__ import annotations

from collections.abc import Sequence

from tools.precision.rows import Row

Rows = Sequence[Row]


def pick(rows: Rows, **fields: str) -> list[Row]:
    """The rows with these fields, in their order."""
    return [row for row in rows if all(getattr(row, name) == value for name, value in fields.items())]


def one(rows: Rows, **fields: str) -> Row | None:
    """The first row with these fields; None if there is none."""
    return next(iter(pick(rows, **fields)), None)


def scenes(rows: Rows) -> list[str]:
    """The scenes of some rows, in their order."""
    return list(dict.fromkeys(row.scene for row in rows))


def each_scene(rows: Rows, say: dict[str, str]) -> str:
    """One sentence of what is to be said of each scene; '' where nothing is."""
    parts = [f"on {scene}, {words}" for scene in scenes(rows) if (words := say.get(scene, ""))]
    text = "; ".join(parts)
    return f"{text[0].upper()}{text[1:]}." if text else ""


def changed(new: float, old: float, what: str) -> str:
    """By which share a size changes, as "saves 12 % of the bytes" or "needs 3 % more bytes"."""
    share = 100 * (new / old - 1)
    if abs(share) < 0.5:
        return f"takes as many {what}"
    return f"saves {-share:.0f} % of the {what}" if share < 0 else f"needs {share:.0f} % more {what}"


def times(new: float, old: float) -> str:
    """How long something takes beside something else."""
    ratio = new / old
    if 0.95 <= ratio <= 1.05:
        return "takes as long"
    return f"takes {figure(ratio)} times as long" if ratio > 1 else f"takes {100 * ratio:.0f} % of the time"


def seconds(value: float) -> str:
    """A time with its unit."""
    if value >= 1:
        return f"{figure(value)} s"
    return f"{figure(1e3 * value)} ms" if value >= 1e-3 else f"{figure(1e6 * value)} µs"


def figure(value: float) -> str:
    """Two significant figures, three from 100 on, without an exponent from 0.001 on."""
    if abs(value) >= 10:
        return f"{float(f'{value:.3g}'):,.0f}"
    if value == 0 or abs(value) >= 1e-3:
        return f"{float(f'{value:.2g}'):g}" if value else "0"
    return f"{value:.1e}".replace("e-0", "e-")


def signed(value: float) -> str:
    """A difference in dB with its sign."""
    return f"{value:+.2f}".replace("-", "\N{MINUS SIGN}")
