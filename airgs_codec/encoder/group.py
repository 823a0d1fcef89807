"""One group from its frames to its files: its key alone, its key with rows of an earlier group kept, its states.

Each step is a job of its own (`group_jobs`): a function of values, with nothing kept between calls.
"""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from airgs_codec.encoder.keys import (
    BaseGroup,
    CodedKeys,
    DecodedKeys,
    code_keys,
    decode_base,
    encode_keys,
    keep_known,
    key_bytes,
)
from airgs_codec.encoder.plan import GroupLayout, find_box, keep_rows, lay_out
from airgs_codec.encoder.representation import Clock, Representation
from airgs_codec.encoder.settings import EncodeSettings
from airgs_codec.encoder.states import code_states, encode_states
from airgs_codec.encoder.survey import Survey
from airgs_codec.encoder.tables import CodedGroup, finish_group
from airgs_codec.package.tables import Group
from airgs_codec.scene.sequence import GaussianSequence


@dataclass(frozen=True, slots=True, eq=False)
class CodedKey:
    """A group whose key is coded: everything that its states need."""

    layout: GroupLayout
    keys: CodedKeys
    pictures: Sequence[Sequence[Representation]]  # unit x key quality
    decoded: Sequence[DecodedKeys]  # for each key quality
    bytes: int  # of all its key units and sidecars

    @property
    def base(self) -> BaseGroup:
        """What a viewer of it knows, where it keeps no rows itself."""
        return BaseGroup(
            self.layout, [part.channels for part in self.decoded], [part.space for part in self.decoded], self.bytes
        )


@dataclass(frozen=True, slots=True, eq=False)
class GroupFiles:
    """A group as it goes into a package."""

    table: Group  # without measured quality
    files: Mapping[str, bytes]  # by path
    rows: NDArray[np.intp]  # (N,) input rows that are written, in file order
    depths: NDArray[np.uint8]  # (N,) deepest level that carries a row; STATIC: none


def code_key(sequence: GaussianSequence, survey: Survey, settings: EncodeSettings) -> CodedKey:
    """The key of a group by itself.

    Raises SceneError for a group that cannot be coded, CodecError when the video encoder fails.
    """
    loaded = sequence.load(range(survey.span.start, survey.span.stop))
    layout = lay_out(loaded, survey, keep_rows(loaded.frames, survey, settings), settings, sequence.fps)
    keys = code_keys(layout, settings)
    pictures = encode_keys(layout, keys, Clock.of(sequence.fps), settings)
    return _decoded(layout, keys, pictures, settings, None)


def keep_key(fresh: CodedKey, of: CodedKey, settings: EncodeSettings, fps: Fraction) -> CodedKey | None:
    """The key of a group that keeps rows of an earlier one, `of`; None where it has none or that saves too little.

    `fresh` is the group's key by itself. Raises CodecError when the video encoder fails.
    """
    base = of.base
    layout = keep_known(fresh.layout, base, settings)
    if layout is None:
        return None
    keys = code_keys(layout, settings)
    pictures = encode_keys(layout, keys, Clock.of(fps), settings)
    if key_bytes(layout, keys, pictures, base.layout) > base.worth_bytes(len(layout.rows)):
        return None
    return _decoded(layout, keys, pictures, settings, base)


def _decoded(
    layout: GroupLayout,
    keys: CodedKeys,
    pictures: Sequence[Sequence[Representation]],
    settings: EncodeSettings,
    base: BaseGroup | None,
) -> CodedKey:
    spaces = [None] * len(settings.key_factors) if base is None else base.spaces
    decoded = [decode_base(layout, keys, pictures, settings, q, space) for q, space in enumerate(spaces)]
    return CodedKey(layout, keys, pictures, decoded, key_bytes(layout, keys, pictures, base.layout if base else None))


def code_group(
    sequence: GaussianSequence, key: CodedKey, of: CodedKey | None, settings: EncodeSettings, first_segment: int
) -> GroupFiles:
    """The files and the table of a group whose key is coded; `of` is the group whose rows it keeps, if it keeps any.

    `first_segment`: how many segments the groups before it have.

    Raises SceneError for a group that cannot be coded, CodecError when the video encoder fails.
    """
    layout = key.layout
    frames = sequence.load(range(layout.span.start, layout.span.stop)).frames
    with tempfile.TemporaryDirectory(prefix="airgs-") as scratch:
        states = code_states(layout, [part.space for part in key.decoded], frames, settings, Path(scratch))
        pictures = encode_states(layout, states, Clock.of(sequence.fps), settings)
        base = None if of is None else of.base
        boxes = [find_box(frames, layout.rows[layout.tile_rows(tile)]) for tile in range(layout.tiles)]
        coded = CodedGroup(layout, key.keys, states, key.pictures, pictures, boxes, first_segment, base)
        table, files = finish_group(coded)
    return GroupFiles(table, files, layout.rows, states.depths)
