"""Encodes one group: a function from its frames, the plan and the group before to files, and the group for the next.

An encode is a fold of `encode_group` over the groups of a sequence, wherever its frames come from.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from airgs_codec.analysis.importance import WrittenRows
from airgs_codec.coding.atlas import UncodableError
from airgs_codec.encoder.deltas import code_deltas
from airgs_codec.encoder.keyframes import CodedKeyframe, code_keyframe
from airgs_codec.encoder.layout import error_with, lay_out, lay_out_again
from airgs_codec.encoder.plan import Plan
from airgs_codec.encoder.streams import FrameClock
from airgs_codec.encoder.survey import Frames, Survey
from airgs_codec.encoder.tables import GroupFiles, finish_group
from airgs_codec.errors import SceneError
from airgs_codec.places.whole import naming
from airgs_codec.render.backend import open_renderer
from airgs_codec.scene.frames import Repaired, turn_least

WORTH = 0.25  # share of a keyframe's bytes that coding its difference must save
MORE = 0.25  # how many more Gaussians, as a share, a keyframe may have than its own pictures need
UNBOUNDED = ("means", "log_scales", "sh_dc", "sh_rest")  # attributes whose numbers may be of any size


@dataclass(frozen=True, slots=True, eq=False)
class Base:
    """The last group whose keyframe is coded by itself, against which later ones may be coded."""

    coded: CodedKeyframe
    survey: Survey
    written: WrittenRows


def encode_run(run: Sequence[Frames], plan: Plan) -> list[GroupFiles]:
    return list(fold(run, plan))


def fold(run: Iterable[Frames], plan: Plan, surveys: Mapping[int, Survey] | None = None) -> Iterator[GroupFiles]:
    """Fold `encode_group` over groups, the first of which begins a run; `surveys`: those that are known, by number."""
    base = None
    for frames in run:
        files, base = encode_group(frames, plan, base, (surveys or {}).get(frames.number))
        yield files


def encode_group(
    frames: Frames, plan: Plan, base: Base | None = None, survey: Survey | None = None
) -> tuple[GroupFiles, Base]:
    """Encode a group and give its files, and the group against which the keyframe of the next one may be coded.

    `base`: what the group before gave. `survey`: what `Survey.of` says of the frames, where that is known already.

    Raises SceneError for a group that cannot be coded, CodecError when the video encoder fails.
    """
    loaded = turn_least(frames.sequence.load(range(frames.start, frames.stop)))
    with naming_farthest(frames):
        coded, base = _code_keyframe(frames, loaded, plan, None if frames.begins else base, survey)
    with tempfile.TemporaryDirectory(prefix="airgs-") as scratch, naming(Path(scratch)), naming_farthest(frames):
        clock = FrameClock.of(frames.sequence.fps)
        deltas = code_deltas(coded.layout, coded.decoded, loaded.frames, plan, clock, Path(scratch))
        return finish_group(coded, deltas, frames.first_segment), base


def _code_keyframe(
    frames: Frames, loaded: Repaired, plan: Plan, base: Base | None, survey: Survey | None
) -> tuple[CodedKeyframe, Base]:
    """Code a keyframe by its difference to the base, or by itself where there is none or it saves too little."""
    settings, views, clock = plan.settings, plan.views, FrameClock.of(frames.sequence.fps)
    allowed, written = settings.row_error if views.trusted else None, None
    if base is not None:
        known = base.coded.layout
        error: float | None = base.written.error
        if frames.stop > base.survey.until:  # the base was chosen without these frames
            survey = survey or Survey.of(frames, views, open_renderer(settings.device))
            written = survey.needed(allowed)
            error = error_with(known, loaded, survey, written, allowed, views.scale)
        if error is not None:
            layout = lay_out_again(loaded, frames, known, survey or base.survey, error, views, settings)
            coded = code_keyframe(layout, settings, clock, base.coded.decoded)
            share = 1.0 if written is None else len(written.rows) / len(known.rows)
            if coded.bytes <= (1 - WORTH) * share * base.coded.bytes:
                return coded, base
    survey = survey or Survey.of(frames, views, open_renderer(settings.device))
    written = written or survey.needed(allowed)
    if base is not None:  # what earlier groups needed, later ones may need
        rows = np.union1d(written.rows, base.coded.layout.rows)
        if len(rows) <= (1 + MORE) * len(written.rows):
            survey, written = survey.joined(base.survey), replace(written, rows=rows)
    layout = lay_out(loaded, frames, survey, written, views, settings)
    coded = code_keyframe(layout, settings, clock)
    return coded, Base(coded, survey, written)


@contextmanager
def naming_farthest(frames: Frames) -> Iterator[None]:
    """Name the most extreme number of a group where the block finds a value in it that no code holds."""
    try:
        yield
    except UncodableError as error:
        numbers = [_farthest(frames, number, name) for number in range(frames.start, frames.stop) for name in UNBOUNDED]
        away, where = max(numbers)
        raise SceneError(f"{where} is {away:g} from the others: {error}") from error


def _farthest(frames: Frames, number: int, attribute: str) -> tuple[float, str]:
    """Return how far the number of an attribute that is farthest from the others is from them, and where it stands."""
    sequence = frames.sequence
    rows = getattr(replace(sequence, orders={}).read(number), attribute).astype(np.float64)
    rows = np.where(np.isfinite(rows), rows, 0).reshape(len(rows), -1)
    away = np.abs(rows - np.median(rows, axis=0)).max(axis=1, initial=0)
    row = int(away.argmax())
    return float(away[row]), f"frame {number} ({sequence.paths[number].name}): {attribute} of row {row}"
