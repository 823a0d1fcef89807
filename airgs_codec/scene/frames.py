"""Frames that are read or made as they are asked for, their repairs, and where their coordinates begin. N Gaussians.

Positions may be float64 until an origin is taken off: far from zero float32 is too coarse for Gaussians. How coarse is
measured against a Gaussian's second largest axis, or LEAST_SIZE of the median of those where it is smaller.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from airgs_codec._arguments import frame_argument
from airgs_codec.errors import SceneError
from airgs_codec.scene.gaussians import LEAST_SHARE, Gaussians, least_turned, mix_rows, rename_axes, to_rotation_vector

Origin = tuple[float, float, float]
ZERO: Origin = (0.0, 0.0, 0.0)
MOVED = 1 / 256  # of its size: a Gaussian's flank falls by 0.61 a size at most, so no pixel changes by 1/255
LEAST_SIZE = 0.1  # of the median size
SAID = 0.01  # share of what is opaque that may move further without a note
RUBBLE = 0.5  # share that may move further than its own size

OPACITY_LOGIT_LIMIT = np.float32(20.0)  # sigmoid(20) = 1 - 2e-9; an infinite logit is stored as this
QUATERNION_MIN_NORM = 1e-12  # below it the squared length leaves float32: no direction to read
LEAST_SAVING = 1.0  # bits a row that other names of axes must save
LEAST_SPREAD = 1e-3  # of a channel: what varies by less takes no bits
MOST_HIDDEN = 0.5  # share of what is opaque
THIN = np.float32(np.log(1e-3))  # what is thinner covers no pixel of its own while it is less than a thousand wide
NOTES = (  # of repairs, after the number of rows
    "Gaussians that are not finite in some frame are not shown in it",
    "Gaussians with zero quaternions were given identity",
    "Gaussians without thickness were given a thousandth of their largest axis",
)


class LazyFrames(Sequence[Gaussians]):
    """Frames of a sequence, of which only the one that was asked for last is in memory."""

    def __init__(self, make: Callable[[int], Gaussians], numbers: Sequence[int]) -> None:
        self._make, self._numbers = make, numbers  # the numbers that `make` takes, in the order of frames
        self._last: tuple[int, Gaussians] | None = None

    def __len__(self) -> int:
        return len(self._numbers)

    def __repr__(self) -> str:
        return f"<{len(self)} frames>"

    @overload
    def __getitem__(self, place: int) -> Gaussians: ...

    @overload
    def __getitem__(self, place: slice) -> LazyFrames: ...

    def __getitem__(self, place: int | slice) -> Gaussians | LazyFrames:
        if isinstance(place, slice):
            return LazyFrames(self._make, self._numbers[place])
        number, last = self._numbers[frame_argument(place, len(self), -len(self))], self._last
        self._last = last = last if last and last[0] == number else (number, self._make(number))
        return last[1]


class HeldFrames:
    """Frames that were read, up to some bytes; the least recently used goes first. A copy in a process holds none."""

    def __init__(self, most: int) -> None:
        self.most = most  # bytes of all frames together
        self._frames: dict[int, Gaussians] = {}  # the most recently used is the last
        self._bytes = 0  # of all of them
        self._lock = threading.Lock()

    def __reduce__(self) -> tuple[type[HeldFrames], tuple[int]]:
        return HeldFrames, (0,)

    def __contains__(self, number: int) -> bool:
        return number in self._frames

    def get(self, number: int, read: Callable[[int], Gaussians]) -> Gaussians:
        with self._lock:
            frame = self._take(number)
        frame = read(number) if frame is None else frame
        with self._lock:
            self._take(number)  # another thread may have read it, too
            self._frames[number] = frame
            self._bytes += frame.nbytes
            while self._bytes > self.most:
                self._take(next(iter(self._frames)))
        return frame

    def clear(self) -> None:
        with self._lock:
            for number in list(self._frames):
                self._take(number)

    def _take(self, number: int) -> Gaussians | None:
        if (frame := self._frames.pop(number, None)) is not None:
            self._bytes -= frame.nbytes
        return frame


def place_rows(g: Gaussians, order: NDArray[np.integer]) -> Gaussians:
    """Return rows (N,) of a frame; -1 stands for one without opacity, with the other values of some finite row."""
    missing = order < 0
    if not missing.any():
        return g.take(order)
    placed = g.take(np.where(missing, np.argmax(_finite_rows(g)), order))
    return replace(placed, opacity_logits=np.where(missing, -OPACITY_LOGIT_LIMIT, placed.opacity_logits))


@dataclass(frozen=True, slots=True, eq=False)
class Repaired:
    """Frames that share rows, with unit quaternions, and what was repaired in them."""

    frames: Sequence[Gaussians]  # each is repaired when it is asked for
    notes: list[str]  # a sentence for each kind of repair; empty: nothing but lengths of quaternions was changed


def repair(frames: Sequence[Gaussians], where: str) -> Repaired:
    """Make frames of one group codable; `where` names them in notes and errors. Row n stays row n.

    Infinite opacity logits become ±20, zero quaternions identity and all others unit length; an axis without thickness
    becomes a thousandth of the largest. A row that is not finite then in some frame has no opacity there, and the other
    values of the first frame where it is finite. Notes give the largest share of what is opaque in a frame. Raises
    SceneError where more than MOST_HIDDEN of that is not finite.
    """
    rows, shares, moved = np.zeros((len(NOTES), len(frames[0])), bool), np.zeros(len(NOTES)), 0.0
    for place, frame in enumerate(frames):
        finite = _finite_rows(_with_finite_values(frame))
        flat = finite & np.isneginf(frame.log_scales).any(axis=1)
        found = np.stack([~finite, finite & (_lengths(frame) < QUATERNION_MIN_NORM), flat])
        seen = np.nan_to_num(frame.opacities().astype(np.float64), nan=1.0) + LEAST_SHARE
        shares = np.maximum(shares, found @ seen / seen.sum())
        rows |= found
        moved = max(moved, moved_share(frame, frame.means))
        if shares[0] > MOST_HIDDEN:
            got = f"NaN or Inf in {shares[0]:.0%} of what is opaque in frame {place} of these"
            raise SceneError(f"{where}: expected finite Gaussians, got {got}")
    stand_in = _stand_in(frames) if rows[0].any() else None
    rows[1:] &= ~rows[0]
    counts = zip(np.count_nonzero(rows, axis=1), shares, NOTES, strict=True)
    notes = [f"{where}: {count} {words} ({share:.2%} of what is opaque)" for count, share, words in counts if count]
    if moved > SAID:
        notes.append(f"{where}: float32 moves {moved:.0%} of what is opaque by more than 1/256 of its size")
    return Repaired(LazyFrames(lambda place: _repaired(frames[place], stand_in), range(len(frames))), notes)


def _stand_in(frames: Sequence[Gaussians]) -> Gaussians:
    """Return each row of the first frame where it is finite; those that never are become some other row."""
    found = _with_finite_values(frames[0])
    left = ~_finite_rows(found)
    for frame in frames[1:]:
        if not left.any():
            break
        values = _with_finite_values(frame)
        usable = left & _finite_rows(values)
        found, left = mix_rows(values, found, usable), left & ~usable
    return found.take(np.where(left, np.argmin(left), np.arange(len(left))))


def _repaired(frame: Gaussians, stand_in: Gaussians | None) -> Gaussians:
    """Return a frame with finite rows, those of `stand_in` without opacity for others, and unit quaternions."""
    frame = _with_finite_values(frame)
    if stand_in is not None and not (finite := _finite_rows(frame)).all():
        hidden = replace(stand_in, opacity_logits=np.full(len(frame), -OPACITY_LOGIT_LIMIT))
        frame = mix_rows(frame, hidden, finite)
    lengths = _lengths(frame)
    zero = lengths < QUATERNION_MIN_NORM
    q = np.where(zero[:, None], np.array([1, 0, 0, 0], np.float32), frame.quaternions)
    return replace(frame, quaternions=(q / np.where(zero, 1.0, lengths)[:, None]).astype(np.float32))


def _with_finite_values(g: Gaussians) -> Gaussians:
    """Return the frame with infinite opacity logits limited and axes without a size thin, unless all of a row are."""
    logits = np.where(np.isinf(g.opacity_logits), np.sign(g.opacity_logits) * OPACITY_LOGIT_LIMIT, g.opacity_logits)
    sizes = g.log_scales
    if (flat := np.isneginf(sizes)).any():
        sizes = np.where(flat, sizes.max(axis=1, keepdims=True) + THIN, sizes)
    return replace(g, opacity_logits=logits.astype(np.float32), log_scales=sizes)


def _finite_rows(g: Gaussians) -> NDArray[np.bool_]:
    rows = np.ones(len(g), bool)
    for finite in map(np.isfinite, g.columns().values()):
        if not finite.all():  # it takes a tenth of the time that looking at every row takes
            rows &= finite.reshape(len(g), -1).all(axis=1)
    return rows


def _lengths(g: Gaussians) -> NDArray[np.float64]:
    w, x, y, z = g.quaternions.T.astype(np.float64)
    return np.asarray(np.sqrt(w * w + x * x + y * y + z * z))


def turn_least(repaired: Repaired) -> Repaired:
    """Rename the axes of rows so that they are turned least, where that saves bits; what they show stays the same.

    A row gets the names that turn it least in the middle frame. All names stay where log-scales and rotation vectors
    would not take LEAST_SAVING bits a row less, by the logarithms of their standard deviations: names may mean
    something, such as which axis is thin.
    """
    frames = repaired.frames
    middle = frames[len(frames) // 2]
    cube = least_turned(middle)
    if _spread(middle) - _spread(rename_axes(middle, cube)) < LEAST_SAVING:
        return repaired
    turned = LazyFrames(lambda place: rename_axes(frames[place], cube), range(len(frames)))
    return replace(repaired, frames=list(turned) if isinstance(frames, list) else turned)


def _spread(g: Gaussians) -> float:
    """Return the bits that log-scales and rotation vectors of a row take, but for a constant."""
    values = np.concatenate([g.log_scales.astype(np.float64), to_rotation_vector(g.quaternions.astype(np.float64))], 1)
    return float(np.log2(np.maximum(values.std(axis=0), LEAST_SPREAD)).sum())


def moved_share(g: Gaussians, positions: NDArray[np.floating], by: float = MOVED) -> float:
    """Return the share of what is opaque that float32 at (N, 3) may move by more than `by` of a Gaussian's size."""
    a, b, c = g.log_scales.T
    x, y, z = np.abs(positions.T)
    with np.errstate(over="ignore", invalid="ignore"):
        steps = np.spacing(np.maximum(np.maximum(x, y), z).astype(np.float32)) / 2
        sizes = np.maximum(np.minimum(a, b), np.minimum(np.maximum(a, b), c))
        sizes = np.exp(np.maximum(sizes, np.median(sizes) + np.float32(np.log(LEAST_SIZE)) if len(sizes) else 0))
        limits = np.float32(by) * sizes
    alpha = np.nan_to_num(np.where(np.isfinite(steps) & (limits > 0), g.opacities(), 0.0))
    return float(alpha[steps > limits].sum() / total) if (total := float(alpha.sum())) else 0.0


def choose_origin(g: Gaussians) -> Origin:
    """Return the origin for a frame: zero, unless about the median float32 moves at most half of what it moves now."""
    if (share := moved_share(g, g.means)) <= SAID:
        return ZERO
    origin = rounded_middle(g.means)
    return origin if 2 * moved_share(g, g.means - np.array(origin)) <= share else ZERO


def rounded_middle(positions: NDArray[np.floating]) -> Origin:
    """Return the median of finite positions (N, 3), rounded to a power of two below the median distance to it."""
    positions = positions[np.isfinite(positions).all(axis=1)].astype(np.float64)
    if not len(positions):
        return ZERO
    middle = np.median(positions, axis=0)
    distance = float(np.median(np.abs(positions - middle).max(axis=1)))
    x, y, z = (np.round(middle / (step := 2.0 ** np.floor(np.log2(distance)))) * step if distance else middle).tolist()
    return x, y, z


def narrowed(g: Gaussians, origin: NDArray[np.float64], path: Path) -> Gaussians:
    """Return the frame of a file with its positions from an origin (3,), in float32.

    Raises SceneError where float32 holds doubles so coarsely that little is left of them.
    """
    if g.means.dtype == np.float32 and not origin.any():
        return g
    positions = g.means - origin
    if g.means.dtype != np.float32 and (share := moved_share(g, positions, 1.0)) > RUBBLE:
        got = f"distances at which float32 moves {share:.0%} of what is opaque by more than its own size"
        raise SceneError(f"{path}: expected Gaussians near each other, got {got}")
    with np.errstate(over="ignore"):  # what becomes infinite is repaired or refused later
        return replace(g, means=positions.astype(np.float32))


def in_world(g: Gaussians, origin: ArrayLike) -> Gaussians:
    """Return a frame for a file of doubles: its positions from zero, float64, where they are from an origin (3,)."""
    positions: NDArray[Any] = g.means + np.asarray(origin, np.float64)
    return replace(g, means=positions)


def origin_notes(g: Gaussians, origin: Origin) -> tuple[str, ...]:
    """Return what people should know of the origin that was chosen by a frame as its file has it."""
    where = ", ".join(f"{value:.15g}" for value in origin)
    moves = "in the files has moved" if g.means.dtype == np.float32 else "would move"
    lost = f"float32 {moves} {moved_share(g, g.means):.0%} of what is opaque by more than 1/256 of its size"
    return (f"positions are taken from the origin ({where}): {lost}",) * (origin != ZERO)
