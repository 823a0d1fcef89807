"""Canonical frames -> keyframe pictures with their detail, and back to the canonical space that viewers have.

A group that has the rows of an earlier one, the base, may be coded as what differs from it. N rows of a group in file
order; n rows of a keyframe tier, P planes, C colour channels, c channels: 7 + C, or 10 + C of differences.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from airgs_codec.coding import escapes
from airgs_codec.coding.atlas import centre_codes, choose_layout, fit_atlas, from_codes, read_codes, to_codes
from airgs_codec.coding.channels import (
    Canonical,
    delta_channels,
    dequantise_keyframe,
    join_canonical,
)
from airgs_codec.coding.rangecoder import Column, ColumnReader, encode_some
from airgs_codec.coding.sidecar import KeyframeSidecar, coarse_codes, detail_columns, pack_keyframe_sidecar, read_detail
from airgs_codec.encoder.layout import GroupLayout
from airgs_codec.encoder.omit import KeyframeOmissions
from airgs_codec.encoder.settings import EncodeSettings
from airgs_codec.encoder.streams import (
    EMPTY,
    AtlasPictures,
    Clock,
    ErrorModel,
    Representation,
    encode_checked,
    encode_parallel,
)
from airgs_codec.media.h264 import KEYFRAME_QP, ClosedGop, keyframe_codec, qp_step
from airgs_codec.package.layout import DELTA, KEYFRAME
from airgs_codec.package.tables import Atlas, LeftOut

PROMISED = 0.5 + 0.5 / qp_step(
    KEYFRAME_QP
)  # steps that a keyframe channel errs by: half a code, and half a step of the codec
SLIGHT = 0.25  # steps by which a value may change and still be that of the base


@dataclass(frozen=True, slots=True, eq=False)
class CodedAtlas:
    """A keyframe tier of one group at one keyframe quality: all that its files but the shared sidecar are made of."""

    atlas: Atlas  # without its largest errors; 0 rows: nothing is sent
    samples: NDArray[np.uint8]  # (P, n) luma
    detail: bytes  # of positions, and escapes; empty where all of it is 0
    error: ErrorModel | None  # None: there are no rows


@dataclass(frozen=True, slots=True, eq=False)
class CodedKeyframes:
    tiers: tuple[tuple[CodedAtlas, ...], ...]  # keyframe tier x keyframe quality
    coarser: tuple[int, ...]  # of each keyframe quality: its cells of canonical means are 2^coarser times the finest
    left_out: tuple[LeftOut, ...]


def code_keyframes(layout: GroupLayout, settings: EncodeSettings, base: Sequence[Canonical] = ()) -> CodedKeyframes:
    """Quantise the keyframe of a group for every tier and keyframe quality.

    With `base`, the canonical space of another group with the same rows as decoded in each keyframe quality, that is
    what differs from it.
    """
    values = layout.keyframe_values()
    omissions = KeyframeOmissions.of(layout, values)
    omitted, planes = (np.empty(0, bool), None) if base else omissions.planes(settings.scaled_price)
    coarser = settings.coarser

    def code(tier: int, quality: int) -> CodedAtlas:
        rows, factor = layout.tier_rows(tier), settings.keyframe_factors[quality]
        if base and layout.before:
            space, steps = base[quality].part(rows), layout.difference_steps
            changes, before = (delta_channels([g.take(rows)], space, steps) for g in (layout.keyframe, layout.before))
            return _code_difference(changes, changes - before, layout.tier_steps(tier, DELTA) * factor)
        sidecar = layout.sidecar(rows)
        detail = detail_columns(sidecar, layout.grid, coarser[quality], coarser[-1])
        return _code_tier(values[None, :, rows], layout.tier_steps(tier) * factor, omitted, detail)

    qualities = range(len(settings.keyframe_factors))
    coded = tuple(tuple(code(tier, quality) for quality in qualities) for tier in range(len(layout.factors)))
    return CodedKeyframes(coded, coarser, tuple(note for note in (omissions.gaussians(), planes) if note))


def _code_tier(
    values: NDArray[np.float64], steps: NDArray[np.float64], omitted: NDArray[np.bool_], detail: list[Column]
) -> CodedAtlas:
    """From (1, c, n) values, (c,) steps, (c,) channels that are left out, and the detail of positions."""
    if not values.size:
        return _no_picture(steps)
    gain = qp_step(KEYFRAME_QP)
    codes = to_codes(values, steps, gain)
    atlas = _with_picture(fit_atlas(codes, gain / 2, omitted))
    samples, bases = escapes.split(centre_codes(codes, atlas))
    error = ErrorModel.of(values.min(axis=(0, 2)), values.max(axis=(0, 2)), atlas, steps / gain)
    return CodedAtlas(atlas, samples[0], encode_some([*detail, *escapes.Escapes.of(bases).columns()]), error)


def _code_difference(
    values: NDArray[np.float64], changes: NDArray[np.float64], steps: NDArray[np.float64]
) -> CodedAtlas:
    """From (1, c, n) values, how they changed, and (c,) steps.

    A row differs by nothing if it is as near as a fresh coding promises, or has hardly changed: then viewers see it
    with whatever error it has, as before.
    """
    near = (np.abs(values) <= PROMISED * steps[:, None]).all(axis=1, keepdims=True)
    near |= (np.abs(changes) <= SLIGHT * steps[:, None]).all(axis=1, keepdims=True)
    sent, none = np.where(near, 0.0, values), np.zeros(len(steps), bool)
    coded = _code_tier(sent, steps, none, []) if sent.any() else _no_picture(steps)
    if not values.size:
        return coded
    error = ErrorModel.of(values.min(axis=(0, 2)), values.max(axis=(0, 2)), coded.atlas, steps / qp_step(KEYFRAME_QP))
    return replace(coded, error=replace(error, held=np.abs(values - sent).max(axis=(0, 2))))


def _no_picture(steps: NDArray[np.float64]) -> CodedAtlas:
    return CodedAtlas(Atlas(0, [0] * len(steps), [], 0, 0), np.empty((0, 0), np.uint8), b"", None)


def _with_picture(atlas: Atlas) -> Atlas:
    """A keyframe always has a picture: of its first channel, if all channels are constant."""
    if atlas.planes:
        return atlas
    return replace(atlas, planes=[0], plane_width=choose_layout(atlas.rows, 1)[0], columns=1)


def encode_keyframes(
    layout: GroupLayout, keyframes: CodedKeyframes, clock: Clock, settings: EncodeSettings
) -> list[list[Representation]]:
    """The picture of every keyframe tier in every keyframe quality, tier x quality."""
    codec, ticks = keyframe_codec(settings.preset), clock.frame_ticks

    def encode(part: CodedAtlas) -> Representation:
        if not part.atlas.rows:
            return EMPTY
        pictures = AtlasPictures.of(part.samples[None], part.atlas)
        gop = ClosedGop(pictures, layout.span[0] * ticks, layout.frames * ticks)
        return encode_checked([gop], pictures.size, clock, codec)

    tasks = [functools.partial(encode, part) for tier in keyframes.tiers for part in tier]
    coded = iter(encode_parallel(tasks, settings.threads))
    return [[next(coded) for _ in tier] for tier in keyframes.tiers]


def keyframe_bytes(layout: GroupLayout, keyframes: CodedKeyframes, pictures: Sequence[Sequence[Representation]]) -> int:
    """Bytes of all keyframe pictures and sidecars of a group, before there are deltas."""
    total = 0
    for tier, of_tier in enumerate(pictures):
        rows = layout.tier_rows(tier)
        if rows.stop > rows.start:
            total += len(pack_keyframe_sidecar(keyframe_sidecar(layout, tier), layout.grid, keyframes.coarser[-1]))
        total += sum(len(gop.fragment) for part in of_tier for gop in part.gops)
        total += sum(len(coded.detail) for coded in keyframes.tiers[tier])
    return total


def keyframe_sidecar(layout: GroupLayout, tier: int, depths: NDArray[np.uint8] | None = None) -> KeyframeSidecar:
    """Make the sidecar of a tier; `depths` (N,) are those of all Gaussians, where they are known."""
    sidecar = layout.sidecar(layout.tier_rows(tier), depths)
    return sidecar if layout.keeps is None else replace(sidecar, codes=sidecar.codes[:0])


def decode_keyframes(
    layout: GroupLayout,
    keyframes: CodedKeyframes,
    pictures: Sequence[Sequence[Representation]],
    settings: EncodeSettings,
    quality: int = 0,
    base: Canonical | None = None,
) -> Canonical:
    """The canonical space of a group as viewers of a keyframe quality have it, every row static.

    `pictures` are those of `encode_keyframes`; `base` is the canonical space, in that quality, that keyframes are
    differences to.
    """
    parts = []
    for tier, of_quality in enumerate(pictures):
        gops, coded, rows = of_quality[quality].gops, keyframes.tiers[tier][quality], layout.tier_rows(tier)
        if not gops:
            if base is not None:
                parts.append(replace(base.part(rows), depths=layout.sidecar(rows).depths))
            continue
        where = f"keyframe tier {tier} of frames {layout.span[0]}-{layout.span[1] - 1}"
        picture = next(iter(gops[0].pictures(where)))
        reader = ColumnReader(coded.detail or None, where)
        coarser = keyframes.coarser[-1 if base else quality]
        sidecar = _read_positions(reader, layout, tier, coarser, keyframes.coarser[-1])
        jumps = escapes.read_columns(reader, (1, len(coded.atlas.planes), coded.atlas.rows))
        codes = read_codes(picture, coded.atlas, jumps.bases(0))
        steps = layout.tier_steps(tier, DELTA if base else KEYFRAME) * settings.keyframe_factors[quality]
        values = from_codes(codes, steps, qp_step(KEYFRAME_QP))
        before, of = None if base is None else base.part(rows), (layout.transform, layout.grid, layout.keyframe_steps)
        parts.append(dequantise_keyframe(values, sidecar, *of, coarser, before))
    return join_canonical(parts, layout.transform)


def _read_positions(
    reader: ColumnReader, layout: GroupLayout, tier: int, coarser: int, coarsest: int
) -> KeyframeSidecar:
    """The rows of a tier as a keyframe quality has them, every one static, from the bytes that are sent."""
    shared = layout.sidecar(layout.tier_rows(tier))
    codes = coarse_codes(shared.codes, shared.cells, layout.grid, coarsest)
    return read_detail(reader, replace(shared, codes=codes), layout.grid, coarser, coarsest)
