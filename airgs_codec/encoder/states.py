"""All frames -> the states of every level: which rows it carries, its samples and escapes, its stream.

T frames and N rows of a group, n rows of a level, P planes. Samples of all levels together may not fit into memory:
they wait in a scratch folder until they are encoded.
"""

from __future__ import annotations

import functools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from airgs_codec.coding import escapes
from airgs_codec.coding.atlas import centre_codes, fit_atlas
from airgs_codec.coding.channels import Canonical, state_channels
from airgs_codec.coding.quantize import to_codes
from airgs_codec.encoder.error_bounds import ErrorModel
from airgs_codec.encoder.leave_out import StateOmissions, note_static
from airgs_codec.encoder.levels import assign_depths
from airgs_codec.encoder.plan import GroupLayout
from airgs_codec.encoder.rank import rank_updates
from airgs_codec.encoder.representation import (
    EMPTY,
    AtlasPictures,
    Clock,
    Representation,
    encode_checked,
    encode_parallel,
)
from airgs_codec.encoder.settings import EncodeSettings
from airgs_codec.media.h264 import STATE_QP, ClosedGop, qp_step, state_codec
from airgs_codec.package.layout import STATE
from airgs_codec.package.tables import STATIC, Atlas, LeftOut
from airgs_codec.scene.gaussians import Gaussians


@dataclass(frozen=True, slots=True)
class StoredSamples:
    """(T, P, n) luma samples in a file."""

    path: Path

    @staticmethod
    def write(path: Path, samples: NDArray[np.uint8]) -> StoredSamples:
        """Put samples into a file."""
        np.save(path, samples)
        return StoredSamples(path)

    def open(self) -> NDArray[np.uint8]:
        """The samples, read as they are used."""
        samples: NDArray[np.uint8] = np.load(self.path, mmap_mode="r")
        return samples


@dataclass(frozen=True, slots=True, eq=False)
class CodedLevel:
    """A level of one group: all that its pictures and escapes are made of."""

    atlas: Atlas  # without its largest errors
    error: ErrorModel | None  # None: it carries no rows
    samples: StoredSamples | None  # None: no segment is fetched
    escapes: tuple[bytes | None, ...]  # of each segment; None: nothing to fetch, the canonical space is shown


@dataclass(frozen=True, slots=True, eq=False)
class CodedStates:
    """The states of one group."""

    depths: NDArray[np.uint8]  # (N,) deepest level that carries a row; STATIC: none
    levels: tuple[CodedLevel, ...]
    left_out: tuple[LeftOut, ...]


def code_states(
    layout: GroupLayout,
    bases: Sequence[Canonical],
    frames: Sequence[Gaussians],
    settings: EncodeSettings,
    scratch: Path,
) -> CodedStates:
    """Quantise the states of a group for every level; `frames` are all of the group, with all input rows.

    The states of a level are differences to the one of `bases`, the canonical space as decoded in each key quality,
    that the level corrects. A segment is fetched if anything in it differs from the original canonical frame by more
    than half a step and rendering shows it. Samples go to files in `scratch`.
    """
    shown = [frame.take(layout.rows) for frame in frames]
    values = state_channels(shown, bases[0], layout.state_steps)
    steps = STATE.steps(layout.state_steps, layout.colours)
    states = values / steps[:, None]
    changes = states - state_channels([layout.key], bases[0], layout.state_steps)[0] / steps[:, None]
    depths = _find_depths(layout, states, changes, settings)
    static = note_static(layout, states, depths)
    omissions = StateOmissions.of(layout, bases[0], values, depths)
    omitted, no_planes = omissions.planes(settings.scaled_price)
    still, no_segments = omissions.segments(settings.scaled_price)
    levels, quality = [], 0
    for number, level in enumerate(settings.levels):
        if level.quality != quality:
            quality = level.quality
            values = state_channels(shown, bases[quality], layout.state_steps)
        rows = (depths != STATIC) & (depths >= number)
        fetched = _fetched_frames(layout, changes, rows, level.factor / 2, still)
        file = scratch / f"{number}.npy"
        levels.append(_code_level(values[:, :, rows], steps * level.factor, omitted, fetched, file))
    return CodedStates(depths, tuple(levels), tuple(n for n in (static, no_planes, no_segments) if n))


def _find_depths(
    layout: GroupLayout, states: NDArray[np.float64], changes: NDArray[np.float64], settings: EncodeSettings
) -> NDArray[np.uint8]:
    """(N,) depths, from (T, 10 + C, N) differences to the decoded and to the original canonical frame, in steps."""
    weights, rank = layout.state_weights(), settings.update_rank
    score, moving = rank_updates(states, changes, weights, layout.usage, rank, settings.keep_all)
    tiers = [settings.tiers_of(level) for level in settings.levels]
    return assign_depths(score, moving, [level.pruned for level in settings.levels], layout.tiers, tiers)


def _fetched_frames(
    layout: GroupLayout,
    changes: NDArray[np.float64],
    rows: NDArray[np.bool_],
    least: float,
    still: NDArray[np.bool_],
) -> list[slice | None]:
    """For each segment its frames in the group, None where nothing is to be fetched.

    That is where no value of `changes` (T, 10 + C, N) exceeds `least` in the rows of a level, a mask (N,), and where
    `still` (S,) says that rendering shows nothing.
    """
    parts: list[slice | None] = []
    for (start, stop), omitted in zip(layout.segments, still, strict=True):
        part = slice(start - layout.span.start, stop - layout.span.start)
        differs = bool((np.abs(changes[part][:, :, rows]) > least).any())
        parts.append(part if differs and not omitted else None)
    return parts


def _code_level(
    values: NDArray[np.float64],
    steps: NDArray[np.float64],
    omitted: NDArray[np.bool_],
    fetched: Sequence[slice | None],
    file: Path,
) -> CodedLevel:
    """From (T, 10 + C, n) values, (10 + C,) steps, the (10 + C,) channels left out and the frames of each segment."""
    nothing = tuple(None for _ in fetched)
    if not values.shape[2]:
        return CodedLevel(Atlas(0, [0] * len(steps), [], 0, 0), None, None, nothing)
    gain = qp_step(STATE_QP)
    codes = to_codes(values, steps, gain)
    atlas = fit_atlas(codes, gain / 2, omitted)
    error = ErrorModel.of(values, atlas, steps / gain)
    if not atlas.planes or fetched == list(nothing):
        return CodedLevel(replace(atlas, planes=[], plane_width=0, columns=0), error, None, nothing)
    centred = centre_codes(codes, atlas)
    samples = np.zeros(centred.shape, np.uint8)
    coded: list[bytes | None] = []
    for part in fetched:
        if part is None:
            coded.append(None)
            continue
        samples[part], bases = escapes.split(centred[part])
        coded.append(escapes.pack(bases))
    return CodedLevel(atlas, error, StoredSamples.write(file, samples), tuple(coded))


def encode_states(
    layout: GroupLayout, states: CodedStates, clock: Clock, settings: EncodeSettings
) -> list[Representation]:
    """The pictures of every level, a closed GOP for each segment that is fetched."""
    codec = state_codec(settings.preset)

    def encode(level: CodedLevel) -> Representation:
        if level.samples is None:
            return EMPTY
        pictures = AtlasPictures.of(level.samples.open(), level.atlas)
        return encode_checked(_level_gops(layout, level, pictures, clock.frame_ticks), pictures.size, clock, codec)

    return encode_parallel([functools.partial(encode, level) for level in states.levels], settings.threads)


def _level_gops(layout: GroupLayout, level: CodedLevel, pictures: AtlasPictures, ticks: int) -> Iterator[ClosedGop]:
    """The segments of a level that are fetched; `pictures` of all frames of the group, `ticks` a frame."""
    for (start, stop), escaped in zip(layout.segments, level.escapes, strict=True):
        if escaped is not None:
            shown = pictures.samples[start - layout.span.start : stop - layout.span.start]
            yield ClosedGop(replace(pictures, samples=shown), start * ticks, ticks)
