"""Attributes of Gaussians <-> channels of atlases: `ATTRIBUTES` has both directions side by side (FORMAT.md §5).

Channels are differences to a canonical space: those of a delta to that of its group, those of a keyframe to
`blank_space`. Their order is `package.layout`'s. N rows of all decoded tiers, n rows of a level, T frames, C colour
channels, c channels. The encoder works in float64, the decoder in float32 but for canonical means.

A colour is the K + 1 SH coefficients of a row, C = 3 (1 + K); the KLT that decorrelates colours takes them in units of
their steps.
"""

from __future__ import annotations

import base64
import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from airgs_codec.coding import kernels
from airgs_codec.coding.motion import motion_units
from airgs_codec.coding.sidecar import KeyframeSidecar, grid_means
from airgs_codec.errors import FormatError
from airgs_codec.package.layout import COLOUR, DELTA, KEYFRAME, Layout
from airgs_codec.package.tables import TRANSFORM_UNITS, DeltaSteps, Grid, KeyframeSteps
from airgs_codec.scene.columns import SHARED, Columns
from airgs_codec.scene.gaussians import Doubles, Gaussians, conjugate, multiply, sigmoid, to_rotation_vector

_MEANS, _SCALES, _OPACITY = (DELTA.slice(name) for name in ("means", "log_scales", "opacity"))
FURTHEST = float(1 << 26)  # steps that a row moves from its canonical mean, so that codes stay below 2^30
OUTLYING = 10.0
WIDTH = 64  # numbers that a row of a decoded frame takes while it is worked out
LEAST_DRAWN = 1 / 255  # INRIA's renderer and all after it do not draw a Gaussian of less alpha
# Decoded opacities stay inside [2^-20, 1 - 2^-20]: outside, the logit of a stored .ply is infinite.
OPACITY_MARGIN = np.float32(2.0**-20)
Channels = NDArray[np.float32] | Callable[[slice], NDArray[np.float32]]  # (c, N), or what gives those of some rows


@dataclass(frozen=True, slots=True, eq=False)
class Canonical(Columns):
    """The canonical space of a group as decoded from its keyframe tiers; rows in file order."""

    means: Doubles  # (N, 3) world units, in the middle of cells
    motion_units: NDArray[np.float32]  # (N,) world units
    quaternions: NDArray[np.float32]  # (N, 4) unit
    log_scales: NDArray[np.float32]  # (N, 3) ln(world units)
    opacity: NDArray[np.float32]  # (N,) alpha; may leave [0, 1] by coding error
    colour: NDArray[np.float32]  # (N, C)
    depths: NDArray[np.uint8]  # (N,) deepest level that carries the row; STATIC: none
    transform: Doubles = field(metadata=SHARED)  # (C, C) KLT, as stored

    def to_gaussians(self) -> Gaussians:
        """Return the canonical space as a frame: what is shown where no delta says otherwise."""
        dc, rest = split_colours(self.colour)
        logits, dc = from_opacity(self.opacity), np.ascontiguousarray(dc)
        return Gaussians(self.means.astype(np.float32), self.quaternions, self.log_scales, logits, dc, rest)


Make = Callable[[Gaussians, Canonical, Doubles], NDArray[np.floating]]
Put = Callable[[NDArray[np.float32], Canonical, NDArray[np.float32]], NDArray[np.float32]]
# How rows g become (N, c) channels of an attribute over a canonical space b, and decoded channels x (c, N) the changes
# of its column in b, see `kernels.change_rows`; s (C,) are the steps of colours before the KLT.
ATTRIBUTES: dict[str, tuple[Make, Put]] = {
    "means": (lambda g, b, s: (g.means - b.means) / b.motion_units[:, None], lambda x, b, s: x * b.motion_units),
    "log_scales": (lambda g, b, s: g.log_scales.astype(np.float64) - b.log_scales, lambda x, b, s: x),
    "quaternions": (
        lambda g, b, s: to_rotation_vector(multiply(g.quaternions, conjugate(b.quaternions.astype(np.float64)))),
        lambda x, b, s: x,
    ),
    "opacity": (lambda g, b, s: (sigmoid(g.opacity_logits.astype(np.float64)) - b.opacity)[:, None], lambda x, b, s: x),
    COLOUR: (
        lambda g, b, s: to_klt((colours(g.sh_dc, g.sh_rest) - b.colour.astype(np.float64)) / s, b.transform),
        lambda x, b, s: kernels.klt_colours(x, b.transform.astype(np.float32), s),
    ),
}


def blank_space(means: Doubles, units: NDArray[np.float32], log_scale: float, transform: Doubles) -> Canonical:
    """Return the base of keyframe channels: rows at `means` (N, 3) of one size, without rotation or colour."""
    row = np.array([1.0, 0, 0, 0]), np.full(3, log_scale), np.zeros(()), np.zeros(len(transform))
    columns = (np.broadcast_to(value.astype(np.float32), (len(means), *value.shape)) for value in row)
    turns, sizes, opacity, colour = columns
    return Canonical(means, units, turns, sizes, opacity, colour, np.zeros(len(means), np.uint8), transform)


def join_canonical(parts: Sequence[Canonical], transform: Doubles) -> Canonical:
    nothing = blank_space(np.empty((0, 3)), np.empty(0, np.float32), 0.0, transform)
    return Canonical.join(parts) if parts else nothing


def keyframe_channels(g: Gaussians, transform: Doubles, steps: KeyframeSteps, unit: float) -> Doubles:
    """Return (7 + C, N) channels of the canonical frame; `transform` is the (C, C) KLT as stored."""
    base = blank_space(g.means.astype(np.float64), np.ones(len(g), np.float32), 0.0, transform)
    return _make(KEYFRAME, replace(g, log_scales=g.log_scales - math.log(unit)), base, steps)


def _make(kind: Layout, g: Gaussians, base: Canonical, steps: KeyframeSteps | DeltaSteps) -> Doubles:
    width = len(base.transform)
    scale, out = colour_steps(steps, width), np.empty((kind.width(width), len(base.means)))
    for name in kind.attributes:
        out[kind.slice(name)] = ATTRIBUTES[name][0](g, base, scale).T
    return out


def dequantise_keyframe(
    channels: Channels,
    sidecar: KeyframeSidecar,
    transform: Doubles,
    grid: Grid,
    steps: KeyframeSteps,
    coarser: int = 0,
    base: Canonical | None = None,
) -> Canonical:
    """Return the canonical space of a group from decoded keyframe channels and the sidecar of their rows, on threads.

    Of (7 + C, N) channels; or of (10 + C, N), which are differences to `base`, the canonical space of another group.
    `coarser` is that of the keyframe quality; the codes of the sidecar may be those of finer cells.
    """
    kind = KEYFRAME if base is None else DELTA
    if base is None:
        means = grid_means(sidecar.codes, sidecar.classes, sidecar.wider, grid, coarser)
        base = blank_space(means, motion_units(sidecar.classes), math.log(grid.unit), transform)
    before, scale = base, colour_steps(steps, len(transform)).astype(np.float32)
    out = {name: np.empty(getattr(base, name).shape, getattr(base, name).dtype) for name in kind.attributes}

    def fill(rows: slice) -> None:
        some, part = _some(channels, rows), before.take(rows)
        for name, column in out.items():
            changes = ATTRIBUTES[name][1](some[kind.slice(name)], part, scale)
            kernels.change_rows(column, np.arange(rows.start, rows.stop), getattr(part, name), changes)

    kernels.for_chunks(fill, len(sidecar.depths), WIDTH)
    return replace(base, depths=sidecar.depths, **out)


def delta_channels(frames: Sequence[Gaussians], base: Canonical, steps: DeltaSteps) -> Doubles:
    """Return (T, 10 + C, N) channels of frames with the rows of `base`.

    While a Gaussian has alpha < 1/255 it is not drawn, so its channels but opacity hold the value they had when it was
    last drawn: changes that nobody sees cost nothing. Before it is first drawn they hold that first value, and 0 if it
    is never drawn.
    """
    out = np.empty((len(frames), DELTA.width(len(base.transform)), len(base.means)))
    drawn = np.empty((len(frames), len(base.means)), bool)
    for t, g in enumerate(frames):
        out[t], drawn[t] = frame_channels(g, base, steps)
    hold_undrawn(out[:, : _OPACITY.start], drawn)
    hold_undrawn(out[:, _OPACITY.stop :], drawn)
    return out


def frame_channels(g: Gaussians, base: Canonical, steps: DeltaSteps) -> tuple[Doubles, NDArray[np.bool_]]:
    """Return (10 + C, N) channels of one frame as it is, and (N,) whether a row is drawn.

    A row that moves further than codes reach is brought nearer and made as much smaller: it looks the same.
    """
    out = _make(DELTA, g, base, steps)
    nearer = np.maximum(np.abs(out[_MEANS]).max(axis=0) / (FURTHEST * steps.means), 1)
    out[_MEANS] /= nearer
    out[_SCALES] -= np.log(nearer)
    return out, sigmoid(g.opacity_logits.astype(np.float64)) >= LEAST_DRAWN


def hold_undrawn(channels: Doubles, drawn: NDArray[np.bool_]) -> None:
    """Hold the last drawn value of (T, c, N) channels; writes into them. `drawn` is (T, N)."""
    rows = np.flatnonzero(~drawn.all(axis=0))
    drawn = drawn[:, rows]
    last = np.where(drawn.any(axis=0), channels[np.argmax(drawn, axis=0), :, rows].T, 0.0)
    for t in range(len(channels)):
        last = np.where(drawn[t], channels[t][:, rows], last)
        channels[t][:, rows] = last


class DeltaApplier:
    """Adds decoded deltas to rows (n,) of one level, ascending; what all frames of a segment share is made once.

    The channels of attributes that are `constant` are the same in all frames.
    """

    def __init__(
        self, base: Canonical, rows: NDArray[np.intp], steps: DeltaSteps, constant: Collection[str] = ()
    ) -> None:
        shown, self.rows, self.constant = base.to_gaussians(), rows, constant
        self.colour_steps = colour_steps(steps, len(base.transform)).astype(np.float32)
        self.before = {"means": shown.means, "log_scales": base.log_scales, "opacity": base.opacity}
        self.before |= {"quaternions": base.quaternions, COLOUR: base.colour}
        self.changing, self.level = list(self.before), base.take(kernels.consecutive(rows))

    def apply(self, channels: Channels) -> Gaussians:
        """Return the frame that decoded delta channels of the n rows make of the canonical space: all N rows.

        Where `channels` is a function from rows to their (10 + C, m) channels, several threads call it.
        """
        out = self.before | {name: np.empty_like(self.before[name]) for name in self.changing}

        def fill(rows: slice) -> None:
            start, stop = np.searchsorted(self.rows, (rows.start, rows.stop)).tolist()
            if stop - start < rows.stop - rows.start:
                for name in self.changing:
                    out[name][rows] = self.before[name][rows]
            some, part = _some(channels, slice(start, stop)), self.level.take(slice(start, stop))
            for name in self.changing:
                changes = ATTRIBUTES[name][1](some[DELTA.slice(name)], part, self.colour_steps)
                kernels.change_rows(out[name], self.rows[start:stop], getattr(part, name), changes)
            if "opacity" in self.changing:
                out["opacity"][rows] = from_opacity(out["opacity"][rows])

        kernels.for_chunks(fill, len(out["means"]), WIDTH)
        if COLOUR in self.changing:
            dc, rest = split_colours(out[COLOUR])
            self.colours = np.ascontiguousarray(dc), rest
        self.before |= {name: out[name] for name in self.constant}
        self.changing = [name for name in out if name not in self.constant]
        return Gaussians(out["means"], out["quaternions"], out["log_scales"], out["opacity"], *self.colours)


def _some(channels: Channels, rows: slice) -> NDArray[np.float32]:
    return channels[:, rows] if isinstance(channels, np.ndarray) else channels(rows)


def from_opacity(opacity: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return finite logits of decoded alpha, which coding error may have carried out of [0, 1] (FORMAT.md §5)."""
    a = np.clip(opacity, OPACITY_MARGIN, 1 - OPACITY_MARGIN)
    return np.log(a / (1 - a))


def colours(sh_dc: NDArray[np.floating], sh_rest: NDArray[np.floating]) -> NDArray[np.floating]:
    """Join (..., N, 3) and (..., N, K, 3) to (..., N, C): DC r g b, then each SH rest coefficient r g b."""
    return np.concatenate([sh_dc, sh_rest.reshape(*sh_rest.shape[:-2], -1)], axis=-1)


def split_colours(channels: NDArray[np.floating]) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
    """Split (..., N, C) into (..., N, 3) and (..., N, K, 3): the inverse of `colours`."""
    rest = channels[..., 3:]
    return channels[..., :3], rest.reshape(*rest.shape[:-1], rest.shape[-1] // 3, 3)


def colour_steps(steps: KeyframeSteps | DeltaSteps, channels: int) -> Doubles:
    """Return (C,) the step of each colour channel before the KLT; after it every step is 1."""
    return np.where(np.arange(channels) < 3, steps.sh_dc, steps.sh_rest)


def fit_colour_transform(scaled: Doubles, weights: Sequence[float] = ()) -> Doubles:
    """Return the KLT (C, C) of colours (N, C) in units of their steps: row k is what the k-th strongest direction adds.

    It is orthonormal, and the entry of a row that is largest by size positive, so that equal scenes give equal
    packages. Colours that are further from the median than OUTLYING times the others count as that far. `weights`
    (3, 3), symmetric, row by row: it is that of r, g, b times them, in which errors of equal length matter equally,
    with their inverse after it.
    """
    away = scaled - np.median(scaled, axis=0)
    sizes = np.linalg.norm(away, axis=1, keepdims=True)
    most = OUTLYING * (float(np.median(sizes)) or float(sizes.max()))
    away = away * np.divide(most, sizes, out=np.ones_like(sizes), where=sizes > most)
    centred = away - away.mean(axis=0)
    mixed = np.kron(np.eye(scaled.shape[1] // 3), np.reshape(weights or np.eye(3), (3, 3)))
    _, vectors = np.linalg.eigh(mixed.T @ centred.T @ centred @ mixed if weights else centred.T @ centred)
    rows = vectors.T[::-1]
    strongest = np.take_along_axis(rows, np.abs(rows).argmax(axis=1)[:, None], axis=1)
    rows = rows * np.where(strongest < 0, -1.0, 1.0)
    return rows @ np.linalg.inv(mixed) if weights else rows


def to_klt(scaled: Doubles, transform: Doubles) -> Doubles:
    """Return the KLT channels whose product with the transform is colours (..., C) in units of their steps.

    The stored transform is rounded, so it is inverted, not transposed.
    """
    return scaled @ np.linalg.inv(transform)


def colour_transform(keyframe: Gaussians, steps: KeyframeSteps, weights: Sequence[float] = ()) -> Doubles:
    """Return the (C, C) KLT of the colours of a canonical frame, rounded as the table of a group stores it."""
    colour = colours(keyframe.sh_dc, keyframe.sh_rest).astype(np.float64)
    fitted = fit_colour_transform(colour / colour_steps(steps, colour.shape[1]), weights)
    return unpack_matrix(pack_matrix(fitted), len(fitted))


def pack_matrix(matrix: Doubles) -> str:
    """Return entries in -1..1 as base64 of little-endian int16 in 1 / TRANSFORM_UNITS, row by row."""
    return base64.b64encode(np.rint(matrix * TRANSFORM_UNITS).astype("<i2").tobytes()).decode("ascii")


def unpack_matrix(text: str, side: int) -> Doubles:
    """Read what `pack_matrix` writes: (side, side). Raises FormatError(bad_value)."""
    try:
        raw = base64.b64decode(text, validate=True)
        return np.frombuffer(raw, "<i2").reshape(side, side) / TRANSFORM_UNITS
    except ValueError as error:
        raise FormatError("bad_value", "colour_transform", f"expected {side}x{side} int16: {error}") from error
