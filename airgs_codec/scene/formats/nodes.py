"""Nodes of a glTF scene that hold splats, and where they put them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

_MOST = 10_000  # nodes that are walked through, and primitives of splats in them
_TOLERANCE = 1e-3  # of a matrix that turns and scales alike, relative
_POINTS = 0


@dataclass(frozen=True, slots=True, eq=False)
class Placed:
    """A primitive of splats with the transform of its node: x -> matrix x + translation."""

    attributes: dict[str, int]  # numbers of accessors
    extension: dict[str, Any]
    matrix: NDArray[np.float64]  # (3, 3), `scale` times the rotation
    translation: NDArray[np.float64]  # (3,)
    scale: float
    rotation: NDArray[np.float64]  # (4,) w, x, y, z


def placed(document: dict[str, Any], extension: str) -> Iterator[Placed]:
    """The primitives with an extension, of all nodes of the scene, in their order.

    Raises ValueError for nodes that are too many, or scale splats differently in different directions; KeyError,
    IndexError and TypeError where the document is broken.
    """
    nodes = document["nodes"]
    roots = document["scenes"][document.get("scene", 0)]["nodes"] if document.get("scenes") else range(len(nodes))
    waiting: list[tuple[int, NDArray[np.float64]]] = []
    seen = _put(waiting, roots, np.eye(4))
    while waiting:
        number, above = waiting.pop()
        node = nodes[number]
        matrix = above @ _local(node)
        primitives = document["meshes"][node["mesh"]]["primitives"] if "mesh" in node else ()
        if (seen := seen + _put(waiting, node.get("children", ()), matrix) + len(primitives)) > _MOST:
            raise ValueError(f"at most {_MOST} nodes and primitives")
        for primitive in primitives:
            if (found := primitive.get("extensions", {}).get(extension)) is not None:
                if primitive.get("mode", 4) != _POINTS:
                    raise ValueError(f"splats as points, got mode {primitive.get('mode', 4)}")
                yield _placed(primitive["attributes"], found, matrix)


def _put(waiting: list[tuple[int, NDArray[np.float64]]], numbers: Any, matrix: NDArray[np.float64]) -> int:
    """Append nodes below a matrix, so that the first is the next to be taken; how many they are."""
    waiting += [(number, matrix) for number in reversed(numbers[: _MOST + 1])]
    return len(numbers)


def _local(node: dict[str, Any]) -> NDArray[np.float64]:
    """(4, 4) the transform of a node."""
    if "matrix" in node:
        return np.array(node["matrix"], np.float64).reshape(4, 4).T
    out = np.eye(4)
    out[:3, :3] = _matrix(node.get("rotation", (0, 0, 0, 1))) * np.array(node.get("scale", (1, 1, 1)), np.float64)
    out[:3, 3] = node.get("translation", (0, 0, 0))
    return out


def _matrix(quaternion: Any) -> NDArray[np.float64]:
    """(3, 3) of a unit quaternion x, y, z, w."""
    x, y, z, w = np.array(quaternion, np.float64)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def _placed(attributes: dict[str, int], extension: dict[str, Any], matrix: NDArray[np.float64]) -> Placed:
    turn = matrix[:3, :3]
    determinant = float(np.linalg.det(turn)) if np.isfinite(matrix).all() else 0.0
    scale = max(determinant, 0.0) ** (1 / 3)
    if not scale > 0 or np.abs(turn @ turn.T / scale**2 - np.eye(3)).max() > _TOLERANCE:
        raise ValueError("a node that moves, turns and scales alike in all directions")
    return Placed(attributes, extension, turn, matrix[:3, 3], scale, _quaternion(turn / scale))


def _quaternion(r: NDArray[np.float64]) -> NDArray[np.float64]:
    """(4,) w, x, y, z of a rotation: the eigenvector of the largest eigenvalue (Bar-Itzhack 2000)."""
    k = np.zeros((4, 4))
    k[0, 0] = np.trace(r)
    k[0, 1:] = k[1:, 0] = r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]
    k[1:, 1:] = r + r.T - np.trace(r) * np.eye(3)
    q = np.linalg.eigh(k)[1][:, -1]
    return np.asarray(-q if q[0] < 0 else q, np.float64)
