"""Repairs that make the frames of one group codable, each named in a note. N rows that all frames share."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from airgs_codec.errors import SceneError
from airgs_codec.scene.frames import LazyFrames
from airgs_codec.scene.gaussians import Gaussians

OPACITY_LOGIT_LIMIT = np.float32(20.0)  # sigmoid(20) = 1 - 2e-9; an infinite logit is stored as this
QUATERNION_MIN_NORM = 1e-12  # below it the squared length leaves float32: no direction to read


@dataclass(frozen=True, slots=True, eq=False)
class Repaired:
    """Frames that share rows, with unit quaternions, and what was repaired in them."""

    frames: Sequence[Gaussians]  # each is repaired when it is asked for
    notes: list[str]  # a sentence for each kind of repair; empty: nothing but lengths of quaternions was changed


def repair(frames: Sequence[Gaussians], where: str) -> Repaired:
    """Make frames of one group codable; `where` names them in notes and errors.

    Infinite opacity logits become ±20 and zero quaternions identity, all others unit length; a row that is not finite
    in some frame is dropped in all of them. All frames are looked at, one after the other. Raises SceneError when no
    row is left.
    """
    finite = np.ones(len(frames[0]), bool)
    zero = np.zeros(len(frames[0]), bool)
    for frame in frames:
        finite &= _finite_rows(_with_finite_opacity(frame))
        zero |= _zero_quaternions(frame)
    if not finite.any():
        raise SceneError(f"{where}: expected finite Gaussians, all {len(finite)} have NaN or Inf in some frame")
    notes = []
    if count := int((~finite).sum()):
        notes.append(f"{where}: {count} Gaussians that are not finite in some frame were dropped")
    if count := int((zero & finite).sum()):
        notes.append(f"{where}: {count} Gaussians with zero quaternions were given identity")
    return Repaired(LazyFrames(lambda place: _repaired(frames[place], finite), range(len(frames))), notes)


def _repaired(frame: Gaussians, finite: NDArray[np.bool_]) -> Gaussians:
    """A frame with the (N,) finite rows alone."""
    frame = _with_finite_opacity(frame)
    return _with_unit_quaternions(frame if finite.all() else frame.take(finite))


def _with_finite_opacity(g: Gaussians) -> Gaussians:
    logits = np.where(np.isinf(g.opacity_logits), np.sign(g.opacity_logits) * OPACITY_LOGIT_LIMIT, g.opacity_logits)
    return replace(g, opacity_logits=logits.astype(np.float32))


def _finite_rows(g: Gaussians) -> NDArray[np.bool_]:
    """(N,) whether every attribute of a row is finite."""
    columns = (g.means, g.quaternions, g.log_scales, g.opacity_logits[:, None], g.sh_dc, g.sh_rest.reshape(len(g), -1))
    return np.logical_and.reduce([np.isfinite(column).all(axis=1) for column in columns])


def _zero_quaternions(g: Gaussians) -> NDArray[np.bool_]:
    """(N,) whether the quaternion of a row has no direction."""
    return np.asarray(np.linalg.norm(g.quaternions.astype(np.float64), axis=1) < QUATERNION_MIN_NORM)


def _with_unit_quaternions(g: Gaussians) -> Gaussians:
    """The frame with quaternions of length 1, identity where they have no direction."""
    zero = _zero_quaternions(g)[:, None]
    q = np.where(zero, np.array([1, 0, 0, 0], np.float32), g.quaternions).astype(np.float64)
    return replace(g, quaternions=(q / np.linalg.norm(q, axis=1, keepdims=True)).astype(np.float32))
