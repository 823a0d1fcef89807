"""From a sequence to a published package: survey, calibrate, encode, check, measure, write the manifests last."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from airgs_codec.analysis.grouping import Grouping, plan_groups
from airgs_codec.analysis.rows import Restored, restore_rows
from airgs_codec.encoder.calibration import cache
from airgs_codec.encoder.calibration.calibrate import calibrate
from airgs_codec.encoder.encoder import EncodeJob
from airgs_codec.encoder.group_length import compare_lengths
from airgs_codec.encoder.leave_out import omit_bands
from airgs_codec.encoder.quality import Rounds
from airgs_codec.encoder.rate_target import Goal
from airgs_codec.encoder.search import search_quality
from airgs_codec.encoder.settings import DEFAULT_LEVELS, DEFAULT_SETTINGS, EncodeSettings
from airgs_codec.encoder.survey import Survey, survey_groups
from airgs_codec.encoder.verify import Attempt, encode_verified
from airgs_codec.encoder.views import ViewPlan, plan_views
from airgs_codec.package.folder import Folder
from airgs_codec.package.manifest import Manifest
from airgs_codec.package.storage import open_storage
from airgs_codec.package.writing import write_tables
from airgs_codec.progress import Progress, Stopwatch, silent
from airgs_codec.scene.sequence import GaussianSequence


@dataclass(frozen=True, slots=True)
class EncodeReport:
    """What was published, and how many seconds each part of the work took."""

    manifest: Manifest
    manifest_bytes: int  # all tables and manifest.mpd together
    rows: Restored  # which frames were put into order
    rows_s: float
    survey_s: float  # views, lengths of groups and what pictures show
    calibrate_s: float
    search_s: float  # for a goal
    encode_s: float
    measure_s: float
    cached: bool  # the calibration was kept from before


@dataclass(frozen=True, slots=True, eq=False)
class Calibrated:
    """A job as its scene asks for it."""

    job: EncodeJob
    settings: EncodeSettings  # nothing is left to calibrate
    expected: float | None  # mean squared error of pictures of the top rung; None: nothing was promised
    decisions: tuple[str, ...]  # about SH bands
    cached: bool


def encode(
    sequence: GaussianSequence,
    path: str | Path,
    settings: EncodeSettings = DEFAULT_SETTINGS,
    *,
    goal: Goal | None = None,
    attribution: str | None = None,
    progress: Progress = silent,
) -> EncodeReport:
    """Encode a sequence and publish it as the package at `path`, a folder or an address, whole or not at all.

    `goal`: a quality factor is searched for that brings the top rung to this PSNR or size; `settings.quality` is where
    the search starts. `attribution`: who made the scene, by default what ATTRIBUTION.txt in its folder says. A package
    that is at `path` already is replaced.

    Raises SceneError for a scene that cannot be coded, CodecError when the video encoder fails, and ConfigError for a
    margin below 0, a goal out of reach or a `path` with other files in it; then `path` is as it was. TransportError for
    an object store that does not answer.
    """
    watch = Stopwatch()
    with open_storage(path).staged() as stage:
        rows = restore_rows(sequence, settings.rows, progress)
        sequence, rows_s = rows.sequence, watch.lap()
        views = plan_views(sequence, settings)
        groups = _plan_groups(sequence, views, settings)
        surveys = survey_groups(sequence, groups.spans, views, progress)
        credit = sequence.attribution if attribution is None else attribution
        survey_s = watch.lap()
        job = EncodeJob(sequence, surveys, views, [*rows.notes, *groups.notes], credit)
        calibrated = calibrate_job(job, settings, progress)
        calibrate_s = watch.lap()
        wanted, job, settings = settings, calibrated.job, calibrated.settings
        rounds, expected = Rounds(settings.measure_pictures), calibrated.expected
        if goal:
            factor, found = search_quality(job, sequence, settings, goal, stage, progress)
            settings, expected = settings.at(factor), None
            rounds = found if rounds.count else rounds
        search_s = watch.lap()
        given = wanted.levels != DEFAULT_LEVELS
        attempt = encode_verified(Attempt(job, sequence, settings, expected, rounds, given), stage, progress)
        decisions = [*attempt.manifest.decisions, *calibrated.decisions, *attempt.stories]
        manifest = replace(attempt.manifest, decisions=decisions)
        size = write_tables(Folder(stage), manifest)
        seconds = (survey_s, calibrate_s, search_s, attempt.encode_s, attempt.measure_s)
        return EncodeReport(manifest, size, rows, rows_s, *seconds, calibrated.cached)


def _plan_groups(sequence: GaussianSequence, views: ViewPlan, settings: EncodeSettings) -> Grouping:
    """Groups of the length that is asked for, or that costs least."""
    if settings.group_frames is not None:
        return plan_groups(sequence, settings.group_frames)
    costs = compare_lengths(sequence, views, settings)
    if not costs:
        return plan_groups(sequence)
    grouping = plan_groups(sequence, costs[0].frames)
    ranked = ", ".join(f"{cost.frames}: {cost.score / costs[0].score - 1:+.0%}" for cost in costs[1:])
    story = (
        f"groups of {costs[0].frames} frames, the cheapest on a sample (others at equal quality, in bytes: {ranked})"
    )
    return replace(grouping, notes=[story, *grouping.notes])


def calibrate_job(job: EncodeJob, settings: EncodeSettings, progress: Progress) -> Calibrated:
    """Settings for this scene, and the job without the SH bands that it does not need."""
    if settings.calibrate == "none":
        return Calibrated(job, settings, None, (), False)
    progress("calibration", 0, 1)
    subject = _longest(job.surveys)
    name = cache.digest(job.sequence, subject, job.views, settings)
    kept = cache.load(name)
    calibration = kept or calibrate(job.sequence, subject, settings)
    if kept is None:
        cache.keep(name, calibration)
    expected = calibration.expected * settings.quality**2 if settings.calibrate == "ladder" else None
    settings = calibration.apply(settings)
    step = settings.steps.key.sh_rest * settings.quality
    bands, note = omit_bands(job.sequence, subject, step, settings.scaled_price)
    if note is None:
        return Calibrated(job, settings, expected, (), kept is not None)
    fewer = replace(job.sequence, max_sh_degree=bands)
    spans = [(survey.span.start, survey.span.stop) for survey in job.surveys]
    surveys = survey_groups(fewer, spans, job.views, progress)
    return Calibrated(replace(job, sequence=fewer, surveys=surveys), settings, expected, (note,), kept is not None)


def _longest(surveys: Sequence[Survey]) -> Survey:
    """The middle one of the longest groups."""
    most = max(survey.span.frames for survey in surveys)
    longest = [survey for survey in surveys if survey.span.frames == most]
    return longest[len(longest) // 2]
