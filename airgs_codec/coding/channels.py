"""Attributes of Gaussians <-> channels of atlases, by way of the canonical space of a group (FORMAT.md §5).

N rows of all decoded tiers, n rows of a level, T frames, C colour channels. `key_channels` and `dequantise_key`,
`state_channels` and `StateApplier.apply` are inverse pairs up to quantisation. The order of channels is
`package.layout`'s. The encoder works in float64, the decoder in float32 but for canonical means.

A colour is the K + 1 SH coefficients of a row, C = 3 (1 + K); the KLT that decorrelates colours takes them in units of
their steps.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields, replace

import numpy as np
from numpy.typing import NDArray

from airgs_codec.coding.grid import grid_means
from airgs_codec.coding.kernels import FrameMemory, add_states, consecutive, for_chunks, klt_colours, to_quaternions
from airgs_codec.coding.motion import motion_units
from airgs_codec.coding.sidecar import KeySidecar
from airgs_codec.package.layout import COLOUR, KEY, STATE
from airgs_codec.package.tables import Grid, KeySteps, StateSteps, pack_matrix
from airgs_codec.scene.gaussians import Gaussians, conjugate, multiply, sigmoid, to_rotation_vector

_MEANS, _SCALES, _ROTATION = (STATE.slice(name) for name in ("means", "log_scales", "quaternions"))
_OPACITY, _COLOUR = STATE.slice("opacity"), STATE.slice(COLOUR)
_CHANGING = ("means", "quaternions", "log_scales", "opacity", "colours")
FURTHEST = float(1 << 26)  # steps that a row moves from its canonical mean, so that codes stay below 2^30
OUTLYING = 10.0
WIDTH = 64  # numbers that a row of a decoded frame takes while it is worked out
LEAST_DRAWN = 1 / 255  # INRIA's renderer and all after it do not draw a Gaussian of less alpha
# Decoded opacities stay inside [2^-20, 1 - 2^-20]: outside, the logit of a stored .ply is infinite.
OPACITY_MARGIN = np.float32(2.0**-20)


@dataclass(frozen=True, slots=True, eq=False)
class Canonical:
    """The canonical space of a group as decoded from its key tiers; rows in file order."""

    means: NDArray[np.float64]  # (N, 3) world units, in the middle of cells
    motion_units: NDArray[np.float32]  # (N,) world units
    quaternions: NDArray[np.float32]  # (N, 4) unit
    log_scales: NDArray[np.float32]  # (N, 3) ln(world units)
    opacity: NDArray[np.float32]  # (N,) alpha; may leave [0, 1] by coding error
    colours: NDArray[np.float32]  # (N, C)
    depths: NDArray[np.uint8]  # (N,) deepest level that carries the row; STATIC: none
    transform: NDArray[np.float64]  # (C, C) KLT, as stored

    def first(self, count: int) -> Canonical:
        """Its first `count` rows: the canonical space that fewer key tiers make."""
        return self.part(slice(count))

    def part(self, rows: slice | NDArray[np.intp]) -> Canonical:
        """Some of its rows; of a slice nothing is copied."""
        return replace(self, **{f.name: getattr(self, f.name)[rows] for f in fields(self) if f.name != "transform"})

    def to_gaussians(self) -> Gaussians:
        """The canonical space as a frame: what is shown where no state says otherwise."""
        return _to_gaussians(self.means, self.quaternions, self.log_scales, self.opacity, self.colours)


def no_rows(transform: NDArray[np.float64]) -> Canonical:
    """The canonical space of a part of a group that has no rows; `transform` is the (C, C) KLT of the group."""
    return Canonical(
        means=np.empty((0, 3)),
        motion_units=np.empty(0, np.float32),
        quaternions=np.empty((0, 4), np.float32),
        log_scales=np.empty((0, 3), np.float32),
        opacity=np.empty(0, np.float32),
        colours=np.empty((0, len(transform)), np.float32),
        depths=np.empty(0, np.uint8),
        transform=transform,
    )


def join_canonical(parts: Sequence[Canonical], transform: NDArray[np.float64]) -> Canonical:
    """The rows of several canonical spaces as those of one group, whose (C, C) KLT `transform` is."""
    names = [f.name for f in fields(Canonical) if f.name != "transform"]
    return Canonical(**{name: np.concatenate([getattr(p, name) for p in parts]) for name in names}, transform=transform)


def key_channels(g: Gaussians, transform: NDArray[np.float64], steps: KeySteps, unit: float) -> NDArray[np.float64]:
    """(7 + C, N) channels of the canonical frame; `transform` is the (C, C) KLT as stored, `unit` that of the grid."""
    colour = colours(g.sh_dc, g.sh_rest).astype(np.float64)
    parts = {
        "log_scales": g.log_scales - math.log(unit),
        "quaternions": to_rotation_vector(g.quaternions.astype(np.float64)),
        "opacity": to_opacity(g.opacity_logits.astype(np.float64))[:, None],
        COLOUR: to_klt(colour / colour_steps(steps.sh_dc, steps.sh_rest, colour.shape[1]), transform),
    }
    return np.concatenate([parts[name] for name in KEY.attributes], axis=1).T


def dequantise_key(
    channels: NDArray[np.float32],
    sidecar: KeySidecar,
    transform: NDArray[np.float64],
    grid: Grid,
    steps: KeySteps,
    coarser: int = 0,
) -> Canonical:
    """Decoded (7 + C, N) key channels and the sidecar of their rows -> the canonical space of the group.

    `coarser` is that of the key quality; the codes of the sidecar may be those of finer cells.
    """
    return dequantise_parts(parts_of(channels), sidecar, transform, grid, steps, coarser)


def dequantise_parts(
    read: Callable[[slice], NDArray[np.float32]],
    sidecar: KeySidecar,
    transform: NDArray[np.float64],
    grid: Grid,
    steps: KeySteps,
    coarser: int = 0,
) -> Canonical:
    """The same canonical space, of channels that `read` gives for some of the rows at a time, on several threads."""
    count, width = len(sidecar.codes), len(transform)
    of = transform.astype(np.float32), colour_steps(steps.sh_dc, steps.sh_rest, width).astype(np.float32)
    size, means, units = np.float32(math.log(grid.unit)), np.empty((count, 3)), np.empty(count, np.float32)
    quaternions, log_scales = np.empty((count, 4), np.float32), np.empty((count, 3), np.float32)
    opacity, colour = np.empty(count, np.float32), np.empty((count, width), np.float32)

    def fill(rows: slice) -> None:
        channels, classes = read(rows), sidecar.classes[rows]
        means[rows] = grid_means(sidecar.codes[rows], classes, sidecar.wider[rows], grid, coarser)
        units[rows] = motion_units(classes)
        log_scales[rows] = channels[KEY.slice("log_scales")].T + size
        quaternions[rows] = to_quaternions(channels[KEY.slice("quaternions")])
        opacity[rows] = channels[KEY.slice("opacity")][0]
        colour[rows] = klt_colours(channels[KEY.slice(COLOUR)], *of).T

    for_chunks(fill, count, WIDTH)
    return Canonical(means, units, quaternions, log_scales, opacity, colour, sidecar.depths, transform)


def add_difference(
    base: Canonical, read: Callable[[slice], NDArray[np.float32]], steps: StateSteps, depths: NDArray[np.uint8]
) -> Canonical:
    """The canonical space that differs from `base` by (10 + C, N) channels, which `read` gives for some of the rows.

    `depths` (N,) are its own.
    """
    out = replace(base, depths=depths, **{name: np.empty_like(getattr(base, name)) for name in _CHANGING})
    of = base.transform.astype(np.float32), colour_steps(steps.sh_dc, steps.sh_rest, base.colours.shape[1])

    def fill(rows: slice) -> None:
        channels, before = read(rows), base.part(rows)
        out.means[rows] = before.means + (channels[_MEANS] * before.motion_units).T
        out.log_scales[rows] = before.log_scales + channels[_SCALES].T
        out.quaternions[rows] = multiply(to_quaternions(channels[_ROTATION]), before.quaternions)
        out.opacity[rows] = before.opacity + channels[_OPACITY][0]
        out.colours[rows] = before.colours + klt_colours(channels[_COLOUR], of[0], of[1].astype(np.float32)).T

    for_chunks(fill, len(depths), WIDTH)
    return out


def state_channels(frames: Sequence[Gaussians], base: Canonical, steps: StateSteps) -> NDArray[np.float64]:
    """(T, 10 + C, N) channels of frames with the rows of `base`.

    While a Gaussian has alpha < 1/255 it is not drawn, so its channels but opacity hold the value they had when it was
    last drawn: changes that nobody sees cost nothing. Before it is first drawn they hold that first value, and 0 if it
    is never drawn.
    """
    out = np.empty((len(frames), STATE.width(base.colours.shape[1]), len(base.means)))
    drawn = np.empty((len(frames), len(base.means)), bool)
    for t, g in enumerate(frames):
        out[t], drawn[t] = frame_channels(g, base, steps)
    hold_undrawn(out[:, : _OPACITY.start], drawn)
    hold_undrawn(out[:, _OPACITY.stop :], drawn)
    return out


def frame_channels(g: Gaussians, base: Canonical, steps: StateSteps) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """(10 + C, N) channels of one frame as it is, and (N,) whether a row is drawn.

    A row that moves further than codes reach is nearer, on the same line, and as much smaller: it looks alike.
    """
    scale = colour_steps(steps.sh_dc, steps.sh_rest, base.colours.shape[1])
    inverse = conjugate(base.quaternions.astype(np.float64))
    opacity = to_opacity(g.opacity_logits.astype(np.float64))
    out = np.empty((STATE.width(base.colours.shape[1]), len(base.means)))
    moves = (g.means - base.means) / base.motion_units[:, None]
    nearer = np.maximum(np.abs(moves).max(axis=1, keepdims=True) / (FURTHEST * steps.means), 1)
    out[_MEANS] = (moves / nearer).T
    out[_SCALES] = (g.log_scales.astype(np.float64) - base.log_scales - np.log(nearer)).T
    out[_ROTATION] = to_rotation_vector(multiply(g.quaternions.astype(np.float64), inverse)).T
    out[_OPACITY] = opacity - base.opacity
    colour = (colours(g.sh_dc, g.sh_rest) - base.colours.astype(np.float64)) / scale
    out[_COLOUR] = to_klt(colour, base.transform).T
    return out, opacity >= LEAST_DRAWN


def hold_undrawn(channels: NDArray[np.float64], drawn: NDArray[np.bool_]) -> None:
    """Hold the last drawn value of (T, c, N) channels; writes into them. `drawn` is (T, N)."""
    rows = np.flatnonzero(~drawn.all(axis=0))
    drawn = drawn[:, rows]
    first = channels[np.argmax(drawn, axis=0), :, rows].T
    last = np.where(drawn.any(axis=0), first, 0.0)
    for t in range(len(channels)):
        last = np.where(drawn[t], channels[t][:, rows], last)
        channels[t][:, rows] = last


@dataclass(frozen=True, slots=True, eq=False)
class StateApplier:
    """Adds decoded states to the n rows of one level; what all frames of a segment share is gathered once."""

    base: Canonical
    shown: Gaussians  # the canonical space as a frame
    rows: NDArray[np.intp]  # (n,) the level's rows among the N, ascending
    colour_steps: NDArray[np.float32]  # (C,)
    transform: NDArray[np.float32]  # (C, C)
    has_rotation: bool  # some rotation channel may differ from 0; this and the next only save work
    has_colour: bool  # some colour channel may differ from 0
    memory: FrameMemory = field(default_factory=FrameMemory)

    @staticmethod
    def of(
        base: Canonical, rows: NDArray[np.intp], steps: StateSteps, has_rotation: bool = True, has_colour: bool = True
    ) -> StateApplier:
        """An applier for these rows (n,); without `has_rotation` or `has_colour` those channels are taken to be 0."""
        scale = colour_steps(steps.sh_dc, steps.sh_rest, base.colours.shape[1]).astype(np.float32)
        transform = base.transform.astype(np.float32)
        return StateApplier(base, base.to_gaussians(), rows, scale, transform, has_rotation, has_colour)

    def apply(self, channels: NDArray[np.float32]) -> Gaussians:
        """The frame that decoded state channels (10 + C, n) make of the canonical space: all N rows."""
        return self.apply_parts(parts_of(channels))

    def apply_parts(self, read: Callable[[slice], NDArray[np.float32]]) -> Gaussians:
        """The same frame, of channels that `read` gives for some of the n rows at a time, on several threads."""
        shown, base = self.shown, self.base
        out = {name: self.memory.empty(getattr(shown, name).shape) for name in self._changing()}
        if self.has_colour:
            out["colours"] = self.memory.empty(base.colours.shape)

        def fill(rows: slice) -> None:
            start, stop = np.searchsorted(self.rows, (rows.start, rows.stop)).tolist()
            if stop - start < rows.stop - rows.start:
                for name, column in out.items():
                    column[rows] = getattr(base if name == "colours" else shown, name)[rows]
            if start < stop:
                self._add(out, self.rows[start:stop], read(slice(start, stop)))

        for_chunks(fill, len(shown), WIDTH)
        if self.has_colour:
            dc, out["sh_rest"] = split_colours(out.pop("colours"))
            out.setdefault("sh_dc", dc)
        return replace(shown, **out)

    def _changing(self) -> list[str]:
        """Names of the columns of a frame, without SH rest, that states may change."""
        names = ["means", "log_scales", "opacity_logits"]
        more = self.has_colour and self.base.colours.shape[1] > 3  # else SH DC is all colours
        return names + ["quaternions"] * self.has_rotation + ["sh_dc"] * more

    def _add(self, out: dict[str, NDArray[np.float32]], rows: NDArray[np.intp], channels: NDArray[np.float32]) -> None:
        """Write what (10 + C, n) channels make of these rows (n,)."""
        base, some = self.base, consecutive(rows)
        out["opacity_logits"][some] = from_opacity(base.opacity[some] + channels[_OPACITY][0])
        moves, turns, colour = channels[_MEANS] * base.motion_units[some], channels[_ROTATION], channels[_COLOUR]
        colour = klt_colours(colour, self.transform, self.colour_steps) if self.has_colour else channels[:0]
        changes = moves, channels[_SCALES], turns if self.has_rotation else channels[:0], colour
        columns = base.means, base.log_scales, base.quaternions, base.colours
        written = out.get("quaternions", base.quaternions), out.get("colours", base.colours)
        add_states(changes, columns, rows, (out["means"], out["log_scales"], *written))
        if "sh_dc" in out:
            out["sh_dc"][some] = out["colours"][some, :3]


def parts_of(channels: NDArray[np.float32]) -> Callable[[slice], NDArray[np.float32]]:
    """Return what gives the channels of some of the rows."""
    return lambda rows: channels[:, rows]


def _to_gaussians(
    means: NDArray[np.float64],
    quaternions: NDArray[np.float32],
    log_scales: NDArray[np.float32],
    opacity: NDArray[np.float32],
    colour: NDArray[np.float32],
) -> Gaussians:
    """Decoded columns -> Gaussians in stored domain."""
    dc, rest = split_colours(colour)
    logits = from_opacity(opacity)
    return Gaussians(means.astype(np.float32), quaternions, log_scales, logits, np.ascontiguousarray(dc), rest)


def to_opacity(logits: NDArray[np.floating]) -> NDArray[np.floating]:
    """Logits -> alpha in [0, 1], which is what is coded."""
    return sigmoid(logits)


def from_opacity(opacity: NDArray[np.float32]) -> NDArray[np.float32]:
    """Decoded alpha -> finite logits; alpha that coding error carried out of [0, 1] is limited first (FORMAT.md §5)."""
    a = np.clip(opacity, OPACITY_MARGIN, 1 - OPACITY_MARGIN)
    return np.log(a / (1 - a))


def colours(sh_dc: NDArray[np.floating], sh_rest: NDArray[np.floating]) -> NDArray[np.floating]:
    """(..., N, 3) and (..., N, K, 3) -> (..., N, C): DC r g b, then each SH rest coefficient r g b."""
    return np.concatenate([sh_dc, sh_rest.reshape(*sh_rest.shape[:-2], -1)], axis=-1)


def split_colours(channels: NDArray[np.floating]) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
    """Inverse of `colours`: (..., N, C) -> (..., N, 3) and (..., N, K, 3)."""
    rest = channels[..., 3:]
    return channels[..., :3], rest.reshape(*rest.shape[:-1], rest.shape[-1] // 3, 3)


def colour_steps(sh_dc: float, sh_rest: float, channels: int) -> NDArray[np.float64]:
    """(C,) step of each colour channel before the KLT, from those of SH DC and SH rest; after it every step is 1."""
    return np.where(np.arange(channels) < 3, sh_dc, sh_rest)


def fit_colour_transform(scaled: NDArray[np.float64], weights: Sequence[float] = ()) -> NDArray[np.float64]:
    """The KLT (C, C) of (N, C) colours in units of their steps: row k is what the k-th strongest direction adds.

    It is orthonormal, and the entry of a row that is largest by size positive, so that equal scenes give equal
    packages. Colours that are further from the median than OUTLYING times the others count as that far. `weights`
    (3, 3), symmetric, row by row: it is that of r, g, b times them, in which errors of equal length matter alike, with
    what undoes them after it.
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


def to_klt(scaled: NDArray[np.float64], transform: NDArray[np.float64]) -> NDArray[np.float64]:
    """(..., C) colours in units of their steps -> KLT channels.

    The exact inverse of `from_klt`: the stored transform is rounded, so it is inverted, not transposed.
    """
    return scaled @ np.linalg.inv(transform)


def from_klt(channels: NDArray[np.floating], transform: NDArray[np.floating]) -> NDArray[np.floating]:
    """(..., C) KLT channels -> colours in units of their steps."""
    return channels @ transform


def colour_transform(key: Gaussians, steps: KeySteps, weights: Sequence[float] = ()) -> str:
    """The KLT of the colours of a canonical frame, as the table of a group stores it (base64 of C x C int16)."""
    colour = colours(key.sh_dc, key.sh_rest).astype(np.float64)
    scaled = colour / colour_steps(steps.sh_dc, steps.sh_rest, colour.shape[1])
    return pack_matrix(fit_colour_transform(scaled, weights))
