"""Frames that are read or made as they are asked for, and repairs that make those of one group codable. N rows."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from typing import overload

import numpy as np
from numpy.typing import NDArray

from airgs_codec._arguments import frame_argument
from airgs_codec.errors import SceneError
from airgs_codec.scene.gaussians import LEAST_SHARE, Gaussians, least_turned, mix_rows, rename_axes, to_rotation_vector
from airgs_codec.scene.origin import SAID, moved_share

OPACITY_LOGIT_LIMIT = np.float32(20.0)  # sigmoid(20) = 1 - 2e-9; an infinite logit is stored as this
QUATERNION_MIN_NORM = 1e-12  # below it the squared length leaves float32: no direction to read
NARROWER = 1.0  # bits a row that other names of axes must save
LEAST_SPREAD = 1e-3  # of a channel: what varies by less takes no bits
HIDDEN = "Gaussians that are not finite in some frame are not shown there"  # in notes of repairs, after their number
ZERO = "Gaussians with zero quaternions were given identity"
MOST_HIDDEN = 0.5  # share of what is opaque: the rest would be a scene that nobody gave
FLAT = "Gaussians without thickness were given a thousandth of their largest axis"
THIN = np.float32(np.log(1e-3))  # what is thinner covers no pixel of its own while it is less than a thousand wide


class LazyFrames(Sequence[Gaussians]):
    """Frames of a sequence, of which only the one that was asked for last is in memory."""

    def __init__(self, make: Callable[[int], Gaussians], numbers: Sequence[int]) -> None:
        """`make` gives the frame of any of the `numbers`, which stand in the order of the frames."""
        self._make, self._numbers = make, numbers
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
        if last is None or last[0] != number:
            last = number, self._make(number)
            self._last = last
        return last[1]


class HeldFrames:
    """Frames that were read, as many as some bytes hold; the one that was asked for longest ago goes first.

    A copy in another process holds none.
    """

    def __init__(self, most: int) -> None:
        """`most`: bytes that all frames together may take."""
        self.most = most
        self._frames: dict[int, Gaussians] = {}  # the one that was asked for last stands last
        self._bytes = 0
        self._lock = threading.Lock()

    def __reduce__(self) -> tuple[type[HeldFrames], tuple[int]]:
        return HeldFrames, (0,)

    def __contains__(self, number: int) -> bool:
        return number in self._frames

    def get(self, number: int, read: Callable[[int], Gaussians]) -> Gaussians:
        """Return a frame, which `read` gives where it is not held."""
        with self._lock:
            frame = self._frames.pop(number, None)
            if frame is not None:
                self._frames[number] = frame
                return frame
        frame = read(number)
        with self._lock:
            if number not in self._frames and _bytes_of(frame) <= self.most:
                self._frames[number] = frame
                self._bytes += _bytes_of(frame)
            while self._bytes > self.most:
                self._bytes -= _bytes_of(self._frames.pop(next(iter(self._frames))))
        return frame

    def clear(self) -> None:
        with self._lock:
            self._frames.clear()
            self._bytes = 0


def _bytes_of(frame: Gaussians) -> int:
    return sum(getattr(frame, field.name).nbytes for field in fields(frame))


def place_rows(g: Gaussians, order: NDArray[np.integer]) -> Gaussians:
    """(N,) rows of a frame, -1 for one that it lacks: that has no opacity, and else the values of some finite row."""
    lacking = order < 0
    if not lacking.any():
        return g.take(order)
    placed = g.take(np.where(lacking, np.argmax(_finite_rows(g)), order))
    return replace(placed, opacity_logits=np.where(lacking, -OPACITY_LOGIT_LIMIT, placed.opacity_logits))


@dataclass(frozen=True, slots=True, eq=False)
class Repaired:
    """Frames that share rows, with unit quaternions, and what was repaired in them."""

    frames: Sequence[Gaussians]  # each is repaired when it is asked for
    notes: list[str]  # a sentence for each kind of repair; empty: nothing but lengths of quaternions was changed


def repair(frames: Sequence[Gaussians], where: str) -> Repaired:
    """Make frames of one group codable; `where` names them in notes and errors. Row n stays row n.

    Infinite opacity logits become ±20 and zero quaternions identity, all others unit length, and what has no thickness
    a thousandth of its largest axis. A row that is not finite then in some frame has no opacity there, and else what
    it has in the first frame where it is finite. All frames are looked at, one after the other. Notes give the largest
    share of what is opaque in a frame. Raises SceneError where that is more than MOST_HIDDEN of what is not finite.
    """
    kinds = (HIDDEN, ZERO, FLAT)
    rows, shares, apart = np.zeros((len(kinds), len(frames[0])), bool), np.zeros(len(kinds)), 0.0
    for place, frame in enumerate(frames):
        finite = _finite_rows(_with_finite_values(frame))
        flat = finite & np.isneginf(frame.log_scales).any(axis=1)
        found = np.stack([~finite, finite & _zero_quaternions(frame), flat])
        seen = np.nan_to_num(frame.opacities().astype(np.float64), nan=1.0) + LEAST_SHARE
        shares = np.maximum(shares, found @ seen / seen.sum())
        rows |= found
        apart = max(apart, moved_share(frame, frame.means))
        if shares[0] > MOST_HIDDEN:
            got = f"NaN or Inf in {shares[0]:.0%} of what is opaque in frame {place} of these"
            raise SceneError(f"{where}: expected finite Gaussians, got {got}")
    stand_in = _stand_in(frames) if rows[0].any() else None
    rows[1:] &= ~rows[0]
    counts = zip(np.count_nonzero(rows, axis=1), shares, kinds, strict=True)
    notes = [f"{where}: {count} {words} ({share:.2%} of what is opaque)" for count, share, words in counts if count]
    if apart > SAID:
        notes.append(f"{where}: float32 moves {apart:.0%} of what is opaque by more than 1/256 of its size")
    return Repaired(LazyFrames(lambda place: _repaired(frames[place], stand_in), range(len(frames))), notes)


def _stand_in(frames: Sequence[Gaussians]) -> Gaussians:
    """Each row as it is in the first frame where it is finite; those that are in none as some other one is."""
    found = _with_finite_values(frames[0])
    left = ~_finite_rows(found)
    for frame in frames[1:]:
        if not left.any():
            break
        values = _with_finite_values(frame)
        known = left & _finite_rows(values)
        found, left = mix_rows(values, found, known), left & ~known
    return found.take(np.where(left, np.argmin(left), np.arange(len(left))))


def turn_least(repaired: Repaired) -> Repaired:
    """Name the axes of rows so that they are turned least, where they take fewer bits then; what they show stays.

    A row has the names that turn it least in the middle frame in all frames of the group. Rows keep the names that they
    have where log-scales and rotation vectors would not take NARROWER bits a row less, by the logarithms of how much
    they vary: names may mean something, such as which axis is thin.
    """
    frames = repaired.frames
    middle = frames[len(frames) // 2]
    cube = least_turned(middle)
    if _spread(middle) - _spread(rename_axes(middle, cube)) < NARROWER:
        return repaired
    turned = LazyFrames(lambda place: rename_axes(frames[place], cube), range(len(frames)))
    return replace(repaired, frames=list(turned) if isinstance(frames, list) else turned)


def _spread(g: Gaussians) -> float:
    """Bits that log-scales and rotation vectors of a row take, but for a constant."""
    values = np.concatenate([g.log_scales.astype(np.float64), to_rotation_vector(g.quaternions.astype(np.float64))], 1)
    return float(np.log2(np.maximum(values.std(axis=0), LEAST_SPREAD)).sum())


def _repaired(frame: Gaussians, stand_in: Gaussians | None) -> Gaussians:
    """A frame with finite rows; those of `stand_in`, without opacity, in place of others."""
    frame = _with_finite_values(frame)
    if stand_in is not None and not (finite := _finite_rows(frame)).all():
        hidden = replace(stand_in, opacity_logits=np.full(len(frame), -OPACITY_LOGIT_LIMIT))
        frame = mix_rows(frame, hidden, finite)
    return _with_unit_quaternions(frame)


def _with_finite_values(g: Gaussians) -> Gaussians:
    """The frame whose infinite opacity logits are limited, and axes without a size thin; a row of no size stays so."""
    logits = np.where(np.isinf(g.opacity_logits), np.sign(g.opacity_logits) * OPACITY_LOGIT_LIMIT, g.opacity_logits)
    sizes = g.log_scales
    if (flat := np.isneginf(sizes)).any():
        sizes = np.where(flat, sizes.max(axis=1, keepdims=True) + THIN, sizes)
    return replace(g, opacity_logits=logits.astype(np.float32), log_scales=sizes)


def _finite_rows(g: Gaussians) -> NDArray[np.bool_]:
    """(N,) whether every attribute of a row is finite."""
    columns = (g.means, g.quaternions, g.log_scales, g.opacity_logits[:, None], g.sh_dc, g.sh_rest.reshape(len(g), -1))
    rows = np.ones(len(g), bool)
    for finite in map(np.isfinite, columns):
        if not finite.all():  # it takes a tenth of the time that looking at every row takes
            rows &= finite.all(axis=1)
    return rows


def _lengths(g: Gaussians) -> NDArray[np.float64]:
    """(N,) of quaternions."""
    w, x, y, z = g.quaternions.T.astype(np.float64)
    return np.asarray(np.sqrt(w * w + x * x + y * y + z * z))


def _zero_quaternions(g: Gaussians) -> NDArray[np.bool_]:
    """(N,) whether the quaternion of a row has no direction."""
    return _lengths(g) < QUATERNION_MIN_NORM


def _with_unit_quaternions(g: Gaussians) -> Gaussians:
    """The frame with quaternions of length 1, identity where they have no direction."""
    lengths = _lengths(g)
    zero = lengths < QUATERNION_MIN_NORM
    q = np.where(zero[:, None], np.array([1, 0, 0, 0], np.float32), g.quaternions)
    return replace(g, quaternions=(q / np.where(zero, 1.0, lengths)[:, None]).astype(np.float32))
