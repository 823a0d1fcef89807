"""The canonical space of a group as decoded from its key units, and the state as difference to it.

N rows of all tiers at hand, n rows of a level, T frames, C colour channels. `key_channels` and `read_key`,
`state_channels` and `apply_state` are inverse pairs up to quantisation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from airgs_codec import transforms as tf
from airgs_codec.gaussians import Gaussians
from airgs_codec.manifest import Grid, KeySteps, StateSteps
from airgs_codec.ordering import morton_decode, morton_encode

KEY_FIXED = 7  # channels before colour in a key atlas: log-scales, rotation vector, opacity
STATE_FIXED = 10  # the same with means before them


@dataclass(frozen=True, slots=True, eq=False)
class Canonical:
    """Decoded canonical space; rows in file order."""

    means: NDArray[np.float64]  # (N, 3) world units, in the middle of cells
    motion_units: NDArray[np.float32]  # (N,) world units
    quaternions: NDArray[np.float32]  # (N, 4) unit
    log_scales: NDArray[np.float32]  # (N, 3)
    opacity: NDArray[np.float32]  # (N,) may leave [0, 1] by coding error
    colours: NDArray[np.float32]  # (N, C)
    depths: NDArray[np.uint8]  # (N,)
    transform: NDArray[np.float64]  # (C, C) KLT, as stored


def cell_bits(classes: NDArray[np.int16], grid: Grid) -> NDArray[np.int64]:
    """(N,) k: the cell of a row is 2^k steps wide."""
    return np.clip(classes.astype(np.int64) - grid.finest, 0, grid.bits)


def grid_codes(means: NDArray[np.floating], classes: NDArray[np.int16], grid: Grid) -> NDArray[np.uint64]:
    """(N, 3) means -> (N,) Morton codes of their cells; |mean - grid_means| <= 2^k step / 2 an axis."""
    bits = cell_bits(classes, grid)[:, None]
    index = np.floor((means.astype(np.float64) - np.asarray(grid.origin)) / (grid.step or 1.0)).astype(np.int64)
    return morton_encode(index >> bits << bits)


def grid_means(codes: NDArray[np.uint64], classes: NDArray[np.int16], grid: Grid) -> NDArray[np.float64]:
    """(N,) Morton codes -> (N, 3) middles of the cells in world units."""
    middle = np.exp2(cell_bits(classes, grid))[:, None] / 2
    return np.asarray(grid.origin) + grid.step * (morton_decode(codes).astype(np.float64) + middle)


def key_steps(steps: KeySteps, channels: int) -> NDArray[np.float64]:
    """(7 + C,) step of each key channel at factor 1; colour channels count in steps already."""
    fixed = [steps.log_scales] * 3 + [steps.quaternions] * 3 + [steps.opacity]
    return np.array(fixed + [1.0] * channels)


def state_steps(steps: StateSteps, channels: int) -> NDArray[np.float64]:
    """(10 + C,) step of each state channel at factor 1."""
    fixed = [steps.means] * 3 + [steps.log_scales] * 3 + [steps.quaternions] * 3 + [steps.opacity]
    return np.array(fixed + [1.0] * channels)


def key_channels(g: Gaussians, transform: NDArray[np.float64], steps: KeySteps) -> NDArray[np.float64]:
    """(7 + C, N) channels of the canonical frame."""
    colour = tf.colours(g.sh_dc, g.sh_rest).astype(np.float64)
    scaled = colour / tf.colour_steps(steps.sh_dc, steps.sh_rest, colour.shape[1])
    columns = [
        g.log_scales.astype(np.float64),
        tf.to_rotation_vector(g.quaternions.astype(np.float64)),
        tf.to_opacity(g.opacity_logits.astype(np.float64))[:, None],
        tf.to_klt(scaled, transform),
    ]
    return np.concatenate(columns, axis=1).T


def read_key(
    channels: NDArray[np.float32],
    codes: NDArray[np.uint64],
    classes: NDArray[np.int16],
    depths: NDArray[np.uint8],
    transform: NDArray[np.float64],
    grid: Grid,
    steps: KeySteps,
) -> Canonical:
    """Decoded (7 + C, N) channels and sidecar columns -> canonical space."""
    colour = tf.from_klt(channels[KEY_FIXED:].T, transform.astype(np.float32))
    scale = tf.colour_steps(steps.sh_dc, steps.sh_rest, colour.shape[1]).astype(np.float32)
    return Canonical(
        means=grid_means(codes, classes, grid),
        motion_units=tf.motion_units(classes),
        quaternions=tf.from_rotation_vector(np.ascontiguousarray(channels[3:6].T)),
        log_scales=np.ascontiguousarray(channels[:3].T),
        opacity=channels[6],
        colours=colour * scale,
        depths=depths,
        transform=transform,
    )


def state_channels(frames: Sequence[Gaussians], base: Canonical, steps: StateSteps) -> NDArray[np.float64]:
    """(T, 10 + C, N) channels of frames whose rows are `base`'s, don't-care samples filled.

    A Gaussian with alpha < 1/255 is not drawn, so its other channels hold their last drawn value (before the first
    time it is drawn: that value; never drawn: 0).
    """
    quaternions = tf.conjugate(base.quaternions.astype(np.float64))
    colour_steps = tf.colour_steps(steps.sh_dc, steps.sh_rest, base.colours.shape[1])
    out = np.empty((len(frames), STATE_FIXED + base.colours.shape[1], len(base.means)))
    for t, g in enumerate(frames):
        opacity = tf.to_opacity(g.opacity_logits.astype(np.float64))
        out[t, 0:3] = ((g.means - base.means) / base.motion_units[:, None]).T
        out[t, 3:6] = (g.log_scales.astype(np.float64) - base.log_scales).T
        out[t, 6:9] = tf.to_rotation_vector(tf.multiply(g.quaternions.astype(np.float64), quaternions)).T
        out[t, 9] = opacity - base.opacity
        colour = (tf.colours(g.sh_dc, g.sh_rest) - base.colours.astype(np.float64)) / colour_steps
        out[t, STATE_FIXED:] = tf.to_klt(colour, base.transform).T
    drawn = np.stack([tf.to_opacity(g.opacity_logits.astype(np.float64)) >= 1 / 255 for g in frames])
    _fill_undrawn(out, drawn)
    return out


def _fill_undrawn(channels: NDArray[np.float64], drawn: NDArray[np.bool_]) -> None:
    """Hold the last drawn value of every channel but opacity, in place; `drawn` is (T, N)."""
    rows = np.flatnonzero(~drawn.all(axis=0))
    others = np.array([c for c in range(channels.shape[1]) if c != 9])
    first = np.argmax(drawn[:, rows], axis=0)
    last = np.where(drawn[:, rows].any(axis=0), channels[first[None], others[:, None], rows], 0.0)
    for t in range(len(channels)):
        last = np.where(drawn[t, rows], channels[t][np.ix_(others, rows)], last)
        channels[t][np.ix_(others, rows)] = last


@dataclass(frozen=True, slots=True, eq=False)
class LevelRows:
    """The rows of a level, with what their states are applied to; made once a segment."""

    base: Canonical
    rows: NDArray[np.intp]  # (n,)
    motion_units: NDArray[np.float32]  # (n,)
    quaternions: NDArray[np.float32]  # (n, 4)
    colour_steps: NDArray[np.float32]  # (C,)
    transform: NDArray[np.float32]  # (C, C)
    turns: bool  # some rotation channel is not zero; these two only save work
    coloured: bool  # some colour channel is not zero

    @staticmethod
    def of(base: Canonical, rows: NDArray[np.intp], steps: StateSteps, turns: bool, coloured: bool) -> LevelRows:
        """Gather the rows."""
        scale = tf.colour_steps(steps.sh_dc, steps.sh_rest, base.colours.shape[1]).astype(np.float32)
        transform = base.transform.astype(np.float32)
        return LevelRows(base, rows, base.motion_units[rows], base.quaternions[rows], scale, transform, turns, coloured)


def apply_state(level: LevelRows, channels: NDArray[np.float32]) -> Gaussians:
    """The frame that decoded state channels (10 + C, n) make of the canonical space.

    Columns are scattered one by one: twice as fast in numpy as rows.
    """
    base, rows = level.base, level.rows
    means, log_scales, opacity = base.means.copy(), base.log_scales.copy(), base.opacity.copy()
    quaternions, colours = base.quaternions, base.colours
    shifts = channels[0:3] * level.motion_units
    for axis in range(3):
        means[rows, axis] += shifts[axis]
        log_scales[rows, axis] += channels[3 + axis]
    opacity[rows] += channels[9]
    if level.turns:
        quaternions = quaternions.copy()
        turn = tf.from_rotation_vector(np.ascontiguousarray(channels[6:9].T))
        quaternions[rows] = tf.multiply(turn, level.quaternions)
    if level.coloured:
        colours = colours.copy()
        colours[rows] += tf.from_klt(channels[STATE_FIXED:].T, level.transform) * level.colour_steps
    return finish(means, quaternions, log_scales, opacity, colours)


def show(base: Canonical) -> Gaussians:
    """The canonical space itself as a frame."""
    return finish(base.means, base.quaternions, base.log_scales, base.opacity, base.colours)


def finish(
    means: NDArray[np.float64],
    quaternions: NDArray[np.float32],
    log_scales: NDArray[np.float32],
    opacity: NDArray[np.float32],
    colours: NDArray[np.float32],
) -> Gaussians:
    """Decoded columns -> stored domain."""
    dc, rest = tf.split_colours(colours)
    logits = tf.from_opacity(opacity)
    return Gaussians(means.astype(np.float32), quaternions, log_scales, logits, np.ascontiguousarray(dc), rest)
