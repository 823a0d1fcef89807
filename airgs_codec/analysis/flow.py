"""Where the Gaussians of one frame are in another one, with other rows in another order.

Every row is matched with the row of the other frame that is most like it, where that holds both ways. Single matches
are noise; the motion is that of nodes, each of which moves and turns as the matches about it do, and every row moves
with the nodes next to it (embedded deformation, Sumner et al. 2007). N rows, M rows of the other frame, S nodes, K
nodes next to a row.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.spatial import cKDTree

from airgs_codec.analysis.matching import attributes, spacing_of
from airgs_codec.scene.gaussians import Gaussians, from_rotation_vector, multiply

NODE_ROWS = (200, 60, 40)  # rows of a node, in rounds: with fewer, what is matched by chance moves them
Vectors = NDArray[np.float64]


def carry(g: Gaussians, frame: Gaussians, velocity: NDArray[np.floating] | None = None) -> Gaussians:
    """Move and turn the rows of `g`, finite, to where they are in `frame`; nothing else changes.

    `velocity`: (N, 3) by which they are expected to move.
    """
    if len(g) < 2 * NODE_ROWS[-1] or len(frame) < 2:
        return g
    spacing = spacing_of(g.means)
    tree, moved = cKDTree(_features(frame, spacing)), g
    if velocity is not None:  # as the rows about them do: what a single row does is noise more often than motion
        moved = _carried(g, velocity.astype(np.float64), g.opacities().astype(np.float64), NODE_ROWS[-1])
    for rows in NODE_ROWS:
        different, match, mutual = _matches(moved, tree, spacing)
        shift = frame.means[match].astype(np.float64) - moved.means
        size = np.maximum(np.exp(moved.log_scales.max(axis=1)), spacing)
        way = np.linalg.norm(shift, axis=1)
        known = mutual & ((different <= 3 * np.median(different)) | (way <= 0.5 * size))
        weight = np.where(known, moved.opacities(), 0.0) / (1 + np.square(way / size))
        moved = _carried(moved, shift, weight, rows)
    return moved


def _carried(g: Gaussians, shift: Vectors, weight: Vectors, rows: int) -> Gaussians:
    """Move and turn rows by nodes of some rows each, by shifts (N, 3) of weight (N,)."""
    here = g.means.astype(np.float64)
    nodes = here[np.linspace(0, len(g) - 1, max(1, len(g) // rows)).astype(int)]
    ties = _ties(here, nodes)
    centre, move, turn = _motion(ties, here, shift, weight)
    spin = ties @ turn
    go = ties @ (move - np.cross(turn, centre)) + np.cross(spin, here)
    turned = multiply(from_rotation_vector(spin), g.quaternions.astype(np.float64))
    return replace(g, means=(here + go).astype(np.float32), quaternions=turned.astype(np.float32))


def unmatched(g: Gaussians, frame: Gaussians) -> NDArray[np.intp]:
    """Return the rows of `frame` that are no row of `g`, which is where it would be in that frame."""
    spacing = spacing_of(g.means)
    _, match, mutual = _matches(g, cKDTree(_features(frame, spacing)), spacing)
    return np.setdiff1d(np.arange(len(frame)), match[mutual])


def _matches(g: Gaussians, tree: cKDTree, spacing: float) -> tuple[Vectors, NDArray[np.intp], NDArray[np.bool_]]:
    """Return (N,) distance to the nearest row in a tree of features, its number, and if both are each other's."""
    wanted = _features(g, spacing)
    distance, match = tree.query(wanted, workers=-1)
    back = cKDTree(wanted).query(tree.data[match], workers=-1)[1]
    return distance, match, back == np.arange(len(g))


def _features(g: Gaussians, spacing: float) -> Vectors:
    """Return (N, 10) mean in units of `spacing`, and attributes with a fifth of their weight in tracked frames."""
    return np.hstack([g.means.astype(np.float64) / spacing, 0.2 * attributes(g)])


def _ties(points: Vectors, nodes: Vectors) -> csr_array:
    """Return (N, S) how much each row moves with the nodes next to it, summing to 1."""
    count = min(6, len(nodes))
    away, which = cKDTree(nodes).query(points, k=count, workers=-1)
    away, which = away.reshape(len(points), count), which.reshape(len(points), count)
    width = np.maximum(away[:, -1:], np.finfo(np.float64).tiny)  # 0 / 0 where nodes are at one point
    values = np.maximum(np.exp(-2 * np.square(away / width)), 1e-6)
    values /= values.sum(axis=1, keepdims=True)
    starts = np.arange(0, count * len(points) + 1, count)
    return csr_array((values.ravel(), which.ravel(), starts), (len(points), len(nodes)))


def _motion(ties: csr_array, here: Vectors, shift: Vectors, weight: Vectors) -> tuple[Vectors, Vectors, Vectors]:
    """Return centre, shift and small turn (S, 3) of each node that best explain shifts (N, 3) of rows about it."""
    pull = (ties.T * weight).tocsr()
    total = pull.sum(axis=1)[:, None] + 1e-12
    centre, move = (pull @ here) / total, (pull @ shift) / total
    trust = total / (total + 0.2 * np.median(total) + 1e-12)  # of a fifth of the usual weight a node moves half as far
    cross = pull @ np.cross(here, shift) / total - np.cross(centre, move)
    outer = (pull @ np.einsum("ni,nj->nij", here, here).reshape(-1, 9)) / total
    spread = outer.reshape(-1, 3, 3) - np.einsum("ni,nj->nij", centre, centre)
    size = np.trace(spread, axis1=1, axis2=2)[:, None, None]
    inertia = size * np.eye(3) - spread + (0.02 * size + 1e-18) * np.eye(3)
    return centre, trust * move, trust * np.linalg.solve(inertia, cross[..., None])[..., 0]
