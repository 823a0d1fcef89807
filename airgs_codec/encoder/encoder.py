"""Gaussians -> files and tables of a package, top to bottom.

Two passes over the sequence: the canonical frames make the key streams; what those decode to is the space that the
states of all frames are differences to. Each pass holds the frames of one group at a time.
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from airgs_codec.encoder.keys import CodedKeys, code_keys, decode_base, encode_keys
from airgs_codec.encoder.plan import GroupLayout, keep_rows, lay_out
from airgs_codec.encoder.representation import Clock
from airgs_codec.encoder.settings import EncodeSettings
from airgs_codec.encoder.states import code_states, encode_states
from airgs_codec.encoder.survey import Survey
from airgs_codec.encoder.tables import (
    CodedSequence,
    Provenance,
    build_manifest,
    number_keys,
    number_segments,
    write_files,
)
from airgs_codec.encoder.views import ViewPlan
from airgs_codec.package.manifest import Manifest
from airgs_codec.progress import Progress, silent
from airgs_codec.scene.sequence import GaussianSequence


@dataclass(frozen=True, slots=True, eq=False)
class EncodeJob:
    """What every encode of one sequence shares, whatever the settings."""

    sequence: GaussianSequence
    surveys: Sequence[Survey]  # one a group
    views: ViewPlan
    notes: Sequence[str] = ()  # what grouping found
    attribution: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class Encoded:
    """What an encode wrote, and which rows it wrote."""

    manifest: Manifest  # without measured quality
    layouts: Sequence[GroupLayout]
    depths: Sequence[NDArray[np.uint8]]  # of the rows of each group, in file order


def encode_sequence(job: EncodeJob, settings: EncodeSettings, folder: Path, progress: Progress = silent) -> Encoded:
    """Write every segment and sidecar of a package into `folder`.

    Raises SceneError for a scene that cannot be coded, CodecError when the video encoder fails.
    """
    clock = Clock.of(job.sequence.fps)
    layouts, keys = _code_all_keys(job, settings, progress)
    key_numbers = number_keys(keys)
    key_streams = encode_keys(layouts, keys, clock, settings, progress)
    with tempfile.TemporaryDirectory(prefix=".scratch", dir=folder) as scratch:
        states = []
        for index, (layout, group) in enumerate(zip(layouts, keys, strict=True)):
            progress("states", index, len(layouts))
            bases = [
                decode_base(layout, group, key_streams, key_numbers[index], settings, quality)
                for quality in range(len(settings.key_factors))
            ]
            frames = job.sequence.load(range(layout.span.start, layout.span.stop)).frames
            states.append(code_states(layout, bases, frames, settings, Path(scratch)))
        state_streams = encode_states(layouts, states, clock, settings, progress)
    coded = CodedSequence(
        clock, layouts, keys, states, key_streams, state_streams, key_numbers, number_segments(states)
    )
    about = Provenance(
        settings,
        job.views.region,
        job.views.table(settings.measure_pictures),
        job.attribution,
        [*job.views.notes, *job.notes],
        len(job.sequence),
        job.sequence.sh_degree,
    )
    manifest = build_manifest(coded, write_files(folder, coded), about)
    return Encoded(manifest, layouts, [group.depths for group in states])


def _code_all_keys(
    job: EncodeJob, settings: EncodeSettings, progress: Progress
) -> tuple[list[GroupLayout], list[CodedKeys]]:
    """The first pass: lay out every group and quantise its canonical frame."""
    layouts, keys = [], []
    for index, survey in enumerate(job.surveys):
        progress("keys", index, len(job.surveys))
        loaded = job.sequence.load(range(survey.span.start, survey.span.stop))
        kept = keep_rows(loaded.frames, survey, settings)
        layout = lay_out(loaded, survey, kept, settings, job.sequence.fps)
        layouts.append(layout)
        keys.append(code_keys(layout, settings))
    return layouts, keys
