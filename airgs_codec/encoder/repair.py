"""What an encoded package leaves out is rendered once more, and taken back where it costs more than was expected.

Calibration looks at a sample of one group; other groups may miss more what was left out. N rows of a group.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from airgs_codec._sampling import evenly_spaced
from airgs_codec.analysis.importance import ExpectedError
from airgs_codec.encoder.batch import Calibrated, Encoded, encode_sequence
from airgs_codec.encoder.pipeline import GroupFiles, PreparedSequence
from airgs_codec.encoder.settings import EncodeSettings
from airgs_codec.jobs.work import Work
from airgs_codec.media.metrics import Picture, psnr, squared_error
from airgs_codec.package.region import draw_views
from airgs_codec.package.tables import STATIC
from airgs_codec.render.backend import Renderer
from airgs_codec.render.compare import View, compare, draw_frames, draw_once
from airgs_codec.scene.gaussians import Gaussians, mean_frame, mix_rows

ATTEMPTS = 4  # encodes at most
SHORTFALL_DB = 0.5  # of the top rung, beyond what is expected, that is taken
CHECKING = 2  # seed of the views that tell what failed: neither those that decided nor those that measure
CHECKED = 8  # pictures that tell what failed


def encode_repaired(
    calibrated: Calibrated, settings: EncodeSettings, work: Work, original: PreparedSequence | None = None
) -> tuple[Encoded, EncodeSettings, list[str]]:
    """The encoded package, the settings that it has in the end, and a line on each thing that was taken back.

    `original` is as in `encode_sequence`.
    """
    stories: list[str] = []
    while True:
        encoded = encode_sequence(calibrated.prepared, settings, work, original)
        if calibrated.expected is None or len(stories) == ATTEMPTS - 1:
            return encoded, settings, stories
        repaired = take_back(settings, calibrated.expected, *_errors_left_out(calibrated.prepared, encoded))
        if repaired is None:
            return encoded, settings, stories
        settings, story = repaired
        stories.append(story)


def take_back(
    settings: EncodeSettings, expected: ExpectedError, rows: float, held: float
) -> tuple[EncodeSettings, str] | None:
    """Settings that leave out less, and why; None where nothing costs too much.

    `rows` and `held` are the mean squared errors of pictures without the rows left out, and with updates of the top
    level withheld. Too much is what alone makes pictures SHORTFALL_DB worse than all was expected to.
    """
    beyond = squared_error(psnr(expected.total) - SHORTFALL_DB) - expected.total
    if rows - expected.rows > beyond and rows - expected.rows >= held - expected.held:
        fewer = replace(settings, steps=replace(settings.steps, rows=settings.steps.rows / 2))
        return fewer, f"Gaussians left out {_cost(rows, expected.rows)}: fewer are"
    pruned = settings.levels[0].pruned
    if pruned > 0 and held - expected.held > beyond:
        part = 0.5 if pruned > 0.1 else 0.0
        levels = (replace(settings.levels[0], pruned=part * pruned), *settings.levels[1:])
        shares = tuple((factor, part * share) for factor, share in settings.shares)  # at other qualities as well
        fixed = replace(settings, levels=levels, shares=shares)
        return fixed, f"updates withheld {_cost(held, expected.held)}: fewer are"
    return None


def _cost(error: float, expected: float) -> str:
    return f"cost {psnr(error):.1f} dB" + (f" where {psnr(expected):.1f} dB were expected" if expected else "")


def _errors_left_out(prepared: PreparedSequence, encoded: Encoded) -> tuple[float, float]:
    """`rows` and `held` of `take_back`, in CHECKED pictures of groups that are evenly spread."""
    errors: list[tuple[float, float]] = []
    cameras = iter(draw_views(prepared.views.region, CHECKED, CHECKING))
    picked = evenly_spaced(len(prepared), CHECKED)
    for i in picked:
        span = prepared.spans[i]
        frames = prepared.sequence.load(range(span.start, span.stop)).frames
        places = evenly_spaced(len(frames), max(1, CHECKED // len(picked)))
        views = list(zip(places, cameras, strict=False))
        errors += _errors_of_group(encoded.group(i), frames, views, prepared.views.renderer)
    rows, held = np.mean(errors, axis=0)
    return float(rows), float(held)


def _errors_of_group(
    coded: GroupFiles, frames: Sequence[Gaussians], views: Sequence[View], renderer: Renderer
) -> Iterator[tuple[float, float]]:
    """The two errors in each view of a group; views count its frames from 0."""
    canonical, rows = mean_frame(frames), np.sort(coded.rows)
    updated = np.ones(len(canonical), bool)
    updated[coded.rows[coded.depths == STATIC]] = False
    whole = draw_once(draw_frames(frames.__getitem__, renderer))
    parts = (lambda place: frames[place].take(rows)), (lambda place: mix_rows(frames[place], canonical, updated))
    fewer, held = (compare(whole, draw_frames(part, renderer), views, Picture.mse) for part in parts)
    return zip(fewer, held, strict=True)
