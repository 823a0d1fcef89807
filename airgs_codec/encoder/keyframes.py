"""Canonical frames -> keyframe pictures with their detail, and back to the canonical space that viewers have.

A group that has the rows of an earlier one, the base, may be coded as what differs from it. N rows of a group in file
order; n rows of a keyframe tier, P planes, C colour channels, c channels: 7 + C, or 10 + C of differences.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from airgs_codec.coding import escapes
from airgs_codec.coding.atlas import centre_codes, choose_layout, fit_atlas, from_codes, read_codes, to_codes
from airgs_codec.coding.channels import Canonical, delta_channels, dequantise_keyframe, join_canonical
from airgs_codec.coding.rangecoder import Column, ColumnReader, encode_some
from airgs_codec.coding.sidecar import coarse_codes, detail_columns, pack_keyframe_sidecar, read_detail
from airgs_codec.encoder.layout import GroupLayout
from airgs_codec.encoder.omit import KeyframeOmissions
from airgs_codec.encoder.settings import EncodeSettings
from airgs_codec.encoder.streams import (
    NO_PICTURES,
    AtlasPictures,
    CodedPictures,
    ErrorModel,
    FrameClock,
    encode_checked,
    in_threads,
)
from airgs_codec.media.h264 import KEYFRAME_QP, ClosedGop, keyframe_codec, qp_step
from airgs_codec.package.layout import DELTA, KEYFRAME
from airgs_codec.package.tables import Atlas, LeftOut

# Steps that a keyframe channel errs by: half a code, and half a step of the codec.
PROMISED = 0.5 + 0.5 / qp_step(KEYFRAME_QP)
SLIGHT = 0.25  # steps by which a value may change and still be that of the base


@dataclass(frozen=True, slots=True, eq=False)
class CodedTier:
    """A keyframe tier of one group at one keyframe quality: all that its files but the shared sidecar are made of."""

    atlas: Atlas  # without its largest errors; 0 rows: nothing is sent
    samples: NDArray[np.uint8]  # (P, n) luma
    detail: bytes  # of positions, and escapes; empty where all of it is 0
    error: ErrorModel | None  # None: there are no rows
    pictures: CodedPictures = NO_PICTURES


@dataclass(frozen=True, slots=True, eq=False)
class CodedKeyframe:
    """The keyframe of a group: everything that its deltas need."""

    layout: GroupLayout
    tiers: Sequence[Sequence[CodedTier]]  # keyframe tier x keyframe quality
    coarsest: int  # cells of the coarsest keyframe quality are 2^coarsest times the finest
    left_out: tuple[LeftOut, ...]
    decoded: Sequence[Canonical]  # the canonical space that viewers have in each keyframe quality, every row static

    def sidecar(self, tier: int, depths: NDArray[np.uint8] | None = None) -> bytes:
        """Pack the sidecar of a tier; `depths` (N,) are those of all Gaussians, where they are known."""
        sidecar = self.layout.sidecar(self.layout.tier_rows(tier), depths)
        if self.layout.base is not None:
            sidecar = replace(sidecar, codes=sidecar.codes[:0])
        return pack_keyframe_sidecar(sidecar, self.layout.grid, self.coarsest) if len(sidecar.depths) else b""

    @property
    def bytes(self) -> int:
        """Return bytes of all keyframe pictures and sidecars, before there are deltas."""
        parts = list(itertools.chain(*self.tiers))
        size = sum(len(part.detail) + sum(len(gop.fragment) for gop in part.pictures.gops) for part in parts)
        return size + sum(len(self.sidecar(tier)) for tier in range(len(self.tiers)))


def code_keyframe(
    layout: GroupLayout, settings: EncodeSettings, clock: FrameClock, base: Sequence[Canonical] = ()
) -> CodedKeyframe:
    """Code the keyframe of a group in every tier and keyframe quality.

    With `base`, the canonical space of another group with the same rows as decoded in each keyframe quality, that is
    what differs from it. Raises CodecError.
    """
    values, qualities = layout.keyframe_values(), range(len(settings.keyframe_factors))
    omissions = KeyframeOmissions.of(layout, values)
    omitted, planes = (np.empty(0, bool), None) if base else omissions.planes(settings.scaled_price)
    coarser, codec, ticks = settings.coarser, keyframe_codec(settings.preset), clock.frame_ticks

    def quantised(tier: int, quality: int) -> CodedTier:
        rows, factor = layout.tier_rows(tier), settings.keyframe_factors[quality]
        if base and layout.before:
            space, steps = base[quality].take(rows), layout.difference_steps
            changes, before = (delta_channels([g.take(rows)], space, steps) for g in (layout.keyframe, layout.before))
            return _code_difference(changes, changes - before, layout.tier_steps(tier, DELTA) * factor)
        detail = detail_columns(layout.sidecar(rows), layout.grid, coarser[quality], coarser[-1])
        return _code_tier(values[None, :, rows], layout.tier_steps(tier) * factor, omitted, detail)

    def coded(part: CodedTier) -> CodedTier:
        if not part.atlas.rows:
            return part
        pictures = AtlasPictures.of(part.samples[None], part.atlas)
        gop = ClosedGop(pictures, layout.span[0] * ticks, layout.frames * ticks)
        return replace(part, pictures=encode_checked([gop], pictures.size, clock, codec))

    parts = [quantised(tier, quality) for tier in range(len(layout.factors)) for quality in qualities]
    done = in_threads(settings.threads, coded, parts)
    tiers = [done[first : first + len(qualities)] for first in range(0, len(done), len(qualities))]
    left_out = tuple(note for note in (omissions.gaussians(), planes) if note)
    spaces: Sequence[Canonical | None] = base or [None] * len(qualities)
    decoded = [_decode_keyframe(layout, [tier[q] for tier in tiers], settings, q, spaces[q]) for q in qualities]
    return CodedKeyframe(layout, tiers, coarser[-1], left_out, decoded)


def _code_tier(
    values: NDArray[np.float64], steps: NDArray[np.float64], omitted: NDArray[np.bool_], detail: list[Column]
) -> CodedTier:
    """Quantise (1, c, n) values with (c,) steps, but for (c,) channels that are left out; `detail` is of positions."""
    if not values.size:
        return _no_picture(steps)
    gain = qp_step(KEYFRAME_QP)
    codes = to_codes(values, steps, gain)
    atlas = _with_picture(fit_atlas(codes, gain / 2, omitted))
    samples, bases = escapes.split(centre_codes(codes, atlas))
    error = ErrorModel.of(values.min(axis=(0, 2)), values.max(axis=(0, 2)), atlas, steps / gain)
    return CodedTier(atlas, samples[0], encode_some([*detail, *escapes.Escapes.of(bases).columns()]), error)


def _code_difference(
    values: NDArray[np.float64], changes: NDArray[np.float64], steps: NDArray[np.float64]
) -> CodedTier:
    """Quantise (1, c, n) values, which changed by so much, with (c,) steps.

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


def _no_picture(steps: NDArray[np.float64]) -> CodedTier:
    return CodedTier(Atlas(0, [0] * len(steps), [], 0, 0), np.empty((0, 0), np.uint8), b"", None)


def _with_picture(atlas: Atlas) -> Atlas:
    """Return the atlas with a picture: of its first channel, if all channels are constant."""
    if atlas.planes:
        return atlas
    return replace(atlas, planes=[0], plane_width=choose_layout(atlas.rows, 1)[0], columns=1)


def _decode_keyframe(
    layout: GroupLayout, tiers: Sequence[CodedTier], settings: EncodeSettings, quality: int, base: Canonical | None
) -> Canonical:
    """Decode the canonical space of a group as viewers of a keyframe quality have it, every row static.

    `base` is the canonical space, in that quality, that the keyframe is a difference to.
    """
    parts, coarsest = [], settings.coarser[-1]
    coarser = settings.coarser[quality] if base is None else coarsest
    for tier, coded in enumerate(tiers):
        rows = layout.tier_rows(tier)
        shared = layout.sidecar(rows)
        before = None if base is None else base.take(rows)
        if not coded.pictures.gops:
            if before is not None:
                parts.append(replace(before, depths=shared.depths))
            continue
        where = f"keyframe tier {tier} of frames {layout.span[0]}-{layout.span[1] - 1}"
        picture = next(iter(coded.pictures.gops[0].pictures(where)))
        reader = ColumnReader(coded.detail or None, where)
        codes = coarse_codes(shared.codes, shared.cells, layout.grid, coarsest)
        sidecar = read_detail(reader, replace(shared, codes=codes), layout.grid, coarser, coarsest)
        jumps = escapes.read_columns(reader, (1, len(coded.atlas.planes), coded.atlas.rows))
        steps = layout.tier_steps(tier, DELTA if base else KEYFRAME) * settings.keyframe_factors[quality]
        values = from_codes(read_codes(picture, coded.atlas, jumps.bases(0)), steps, qp_step(KEYFRAME_QP))
        of = layout.transform, layout.grid, layout.keyframe_steps
        parts.append(dequantise_keyframe(values, sidecar, *of, coarser, before))
    return join_canonical(parts, layout.transform)
