"""Where a scene stands in a world with y up: the similarity that a package tells players.

Gaussians and viewing regions stay in the scene's own coordinates. The world is right-handed with y up, as that of glTF.
A transform is 12 numbers, three rows of four: p in the scene is at A p + b in the world, with (A | b) these rows and
A a rotation times a scale. It alone says which way is up (the second row) and how long a unit is (the scale).
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from airgs_codec.errors import ConfigError
from airgs_codec.package.tables import World

if TYPE_CHECKING:  # decoding loads no file formats
    from airgs_codec.scene.formats.form import Axes

Vector = NDArray[np.float64]

LEAST_SCALE, MOST_SCALE = 1e-6, 1e6
MOST_NUMBER = 1e30  # of a transform, as of all coordinates in tables
TOLERANCE = 1e-5  # of the products of axes of length 1, and of the scale, beside its bounds
AXES = {sign + name: tuple(int(f"{sign}1") * (name == axis) for axis in "xyz") for name in "xyz" for sign in ("", "-")}
_HALF_TURN = np.diag([1.0, -1.0, -1.0])  # about x


def fault_of(transform: Sequence[float]) -> str | None:
    """What is wrong with a transform of 12 numbers, in words; None where it is a similarity without mirror."""
    large = [value for value in transform if not abs(value) <= MOST_NUMBER]
    if len(transform) != 12 or large:
        return f"expected 12 finite numbers of at most {MOST_NUMBER:g}, got {large[0] if large else len(transform)}"
    axes = np.reshape(transform, (3, 4))[:, :3]
    sizes = np.linalg.norm(axes, axis=1)
    scale = float(sizes.mean())
    if not LEAST_SCALE * (1 - TOLERANCE) <= scale <= MOST_SCALE * (1 + TOLERANCE):
        return f"expected a scale of {LEAST_SCALE:g} to {MOST_SCALE:g}, got {scale:g}"
    products = axes @ axes.T / scale**2
    if np.abs(products - np.eye(3)).max() > TOLERANCE:
        return f"expected a rotation with one scale for all axes, got rows {axes.tolist()}"
    if np.linalg.det(axes / scale) < 0:
        return "expected a right-handed turn, got one that mirrors"
    return None


def world_from(up: Sequence[float], metres: float | None = None) -> World:
    """The world of a scene of which `up` (3,) points up and a unit is so many metres; None: nobody knows how many.

    The turn is the shortest one, after half a turn about x where up is in the lower half space: so y down, z up and
    y up become (x, -y, -z), (x, z, -y) and (x, y, z). Raises ConfigError.
    """
    direction, length = np.array(up, np.float64), float(np.linalg.norm(up))
    if not (0 < length < np.inf):
        raise ConfigError(f"up: expected a direction, got {list(up)}")
    direction /= length
    first = _HALF_TURN if direction[1] < 0 else np.eye(3)
    x, y, z = first @ direction
    cross = np.array([[0, -x, 0], [x, 0, z], [0, -z, 0]])  # Rodrigues: the product of (x, y, z) and the y axis
    turn = (np.eye(3) + cross + cross @ cross / (1 + y)) @ first
    scale = 1.0 if metres is None else metres
    if not LEAST_SCALE <= scale <= MOST_SCALE:
        raise ConfigError(f"scale: expected {LEAST_SCALE:g} to {MOST_SCALE:g} metres a unit, got {scale:g}")
    rows = np.hstack([scale * turn, np.zeros((3, 1))]) + 0.0  # no -0
    return World(rows.ravel().tolist(), metres is not None)


def up_of(world: World) -> Vector:
    """(3,) which way is up in the coordinates of the scene, of length 1."""
    row = np.array(world.transform[4:7])
    return np.asarray(row / np.linalg.norm(row))


def unit_of(world: World) -> float | None:
    """Metres that a unit of the scene is long; None where nobody knows."""
    return float(np.linalg.norm(world.transform[4:7])) if world.metric else None


def parse_up(text: str) -> tuple[float, ...]:
    """A direction from text: an axis such as y or -y, or X,Y,Z. Raises ConfigError."""
    if text in AXES:
        return AXES[text]
    try:
        x, y, z = (float(part) for part in text.split(","))
    except ValueError as error:
        raise ConfigError(f"expected {', '.join(AXES)} or X,Y,Z that points up, got {text!r}") from error
    return x, y, z


def read_world(path: Path) -> World:
    """A transform to a world with y up in metres from a file: 3x4 or 4x4 numbers row by row, as text or as JSON.

    Raises ConfigError for anything else.
    """
    try:
        text = path.read_text(encoding="utf-8")
        values = np.array(json.loads(text) if text.lstrip()[:1] == "[" else text.split(), np.float64).ravel()
    except OSError as error:
        raise ConfigError(f"{path}: cannot read a transform: {error.strerror}") from error
    except (ValueError, TypeError, OverflowError, RecursionError) as error:
        raise ConfigError(f"{path}: expected 12 or 16 numbers, row by row: {str(error)[:120]}") from error
    if len(values) == 16 and not np.array_equal(values[12:], [0, 0, 0, 1]):
        raise ConfigError(f"{path}: expected a last row of 0 0 0 1, got {values[12:].tolist()}")
    if len(values) not in (12, 16):
        raise ConfigError(f"{path}: expected 12 or 16 numbers, row by row, got {len(values)} numbers")
    if fault := fault_of(values[:12].tolist()):
        raise ConfigError(f"{path}: {fault}")
    return World(values[:12].tolist(), metric=True)


def world_words(world: World | None) -> str:
    """Which way is up and how long a unit is, for people."""
    if world is None:
        return "up: not told, players take that of the views of the region; units: not told"
    up = ", ".join(f"{number:.6g}" for number in up_of(world).round(6) + 0.0)
    unit = unit_of(world)
    return f"up: ({up}); units: " + ("not told" if unit is None else f"one is {unit:.6g} m")


def misread(world: World | None, form: str, axes: Axes | None) -> list[str]:
    """A line where the specification of a format says otherwise of up and units than a package: coordinates stay."""
    if axes is None:
        return []
    meant, told = world_words(world_from(axes.up, axes.metres)), world_words(world)
    return [] if meant == told else [f"coordinates stay: readers of {form} take {meant}; here it is {told}"]
