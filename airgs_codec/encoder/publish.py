"""From a sequence to a published package: calibrate, encode, check, measure, write the manifests last."""

from __future__ import annotations

import shutil
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from airgs_codec.analysis.grouping import Grouping, plan_groups
from airgs_codec.encoder.calibration import cache
from airgs_codec.encoder.calibration.solve import calibrate
from airgs_codec.encoder.encode import encode_sequence
from airgs_codec.encoder.leave_out import needed_bands
from airgs_codec.encoder.plan import Survey, survey_group
from airgs_codec.encoder.quality import measure_quality
from airgs_codec.encoder.rate_target import PSNR, Goal, find_quality
from airgs_codec.encoder.settings import DEFAULT_SETTINGS, EncodeSettings
from airgs_codec.package.mpd import write_mpd
from airgs_codec.package.staging import staged, write_file
from airgs_codec.package.store import Package
from airgs_codec.package.tables import JSON_NAME, MPD_NAME, LeftOut, Manifest, Views, pooled_quality
from airgs_codec.progress import Progress, silent
from airgs_codec.render import Camera
from airgs_codec.scene.camera import measured_views, training_views
from airgs_codec.scene.orbits import orbit_views
from airgs_codec.scene.sequence import GaussianSequence

TRIAL_FRAMES = 6  # measured in each segment by a search for a PSNR, where the package itself is not measured


@dataclass(frozen=True, slots=True)
class EncodeReport:
    """What was published and what it took."""

    manifest: Manifest
    manifest_bytes: int
    survey_s: float  # training views
    calibrate_s: float
    cached: bool  # the calibration was
    search_s: float  # for a goal
    encode_s: float
    measure_s: float


@dataclass(frozen=True, slots=True, eq=False)
class _Job:
    """What every encode of one sequence shares."""

    original: GaussianSequence
    sequence: GaussianSequence  # without the SH bands left out
    grouping: Grouping
    surveys: list[Survey]
    training: Sequence[Camera]
    shown: Sequence[Camera]
    views: Views
    attribution: str
    progress: Progress

    def encode(self, settings: EncodeSettings, folder: Path) -> Manifest:
        return encode_sequence(
            self.sequence,
            self.surveys,
            self.training,
            self.views,
            settings,
            folder,
            self.attribution,
            self.grouping.notes,
            self.progress,
        )

    def measure(self, manifest: Manifest, folder: Path, frames: int) -> Manifest:
        return measure_quality(Package(folder, manifest, 0), self.original, self.shown, frames, self.progress)


def encode(
    sequence: GaussianSequence,
    path: str | Path,
    settings: EncodeSettings = DEFAULT_SETTINGS,
    *,
    goal: Goal | None = None,
    attribution: str = "",
    progress: Progress = silent,
) -> EncodeReport:
    """Encode a sequence and publish it as the package at `path`, whole or not at all.

    `goal`: a quality factor is searched for that brings the top rung to this PSNR or size; `settings.quality` is where
    the search starts. `attribution`: who made the scene, for the record. An existing package at `path` is replaced.

    Raises SceneError for a scene that cannot be coded, CodecError when the video encoder fails, and ConfigError for a
    goal out of reach or a `path` with other files in it; then `path` is as it was.
    """
    target = Path(path)
    given = list(sequence.cameras)
    cameras = given or orbit_views(sequence.read(len(sequence) // 2))
    training = training_views(cameras)
    shown = measured_views(cameras)
    views = Views(
        "given" if given else "generated",
        len(training),
        len(shown),
        shown[0].width,
        shown[0].height,
        "original" if settings.measure_frames else "none",
    )
    with staged(target) as stage:
        clock = _Clock()
        grouping = plan_groups(sequence, settings.group_frames)
        surveys = _survey(sequence, grouping, training, progress)
        survey_s = clock.lap()
        coded, cached = sequence, False
        left_out: list[LeftOut] = []
        if settings.calibrate != "none":
            progress("calibration", 0, 1)
            subject = _longest(surveys)
            settings, cached = _calibrate(sequence, subject, training, views, settings)
            step, span = settings.steps.key.sh_rest * settings.quality, subject.stop - subject.start
            bands, left_out = needed_bands(sequence, subject.canonical, span, training, step, settings.scaled_price)
            if left_out:
                coded = replace(sequence, max_sh_degree=bands)
                surveys = _survey(coded, grouping, training, progress)
        calibrate_s = clock.lap()
        job = _Job(sequence, coded, grouping, surveys, training, shown, views, attribution, progress)
        if goal:
            settings = replace(settings, quality=_search(job, settings, goal, stage))
        search_s = clock.lap()
        manifest = job.encode(settings, stage)
        manifest = replace(manifest, left_out=left_out + manifest.left_out)
        encode_s = clock.lap()
        if settings.measure_frames:
            manifest = job.measure(manifest, stage, settings.measure_frames)
        tables = write_file(stage, JSON_NAME, manifest.to_json().encode())
        mpd = write_file(stage, MPD_NAME, write_mpd(manifest))
        size = tables.bytes + mpd.bytes
        report = EncodeReport(manifest, size, survey_s, calibrate_s, cached, search_s, encode_s, clock.lap())
    return report


def _survey(
    sequence: GaussianSequence, grouping: Grouping, training: Sequence[Camera], progress: Progress
) -> list[Survey]:
    surveys = []
    for i, (start, stop) in enumerate(grouping.spans):
        progress("training views", i, len(grouping.spans))
        surveys.append(survey_group(sequence, i, start, stop, training))
    return surveys


def _longest(surveys: list[Survey]) -> Survey:
    """The middle one of the longest groups."""
    most = max(s.stop - s.start for s in surveys)
    longest = [s for s in surveys if s.stop - s.start == most]
    return longest[len(longest) // 2]


class _Clock:
    """Seconds between laps."""

    def __init__(self) -> None:
        self._last = time.perf_counter()

    def lap(self) -> float:
        now = time.perf_counter()
        seconds, self._last = now - self._last, now
        return seconds


def _calibrate(
    sequence: GaussianSequence,
    subject: Survey,
    training: Sequence[Camera],
    views: Views,
    settings: EncodeSettings,
) -> tuple[EncodeSettings, bool]:
    """Settings for this scene, and whether they were kept from before."""
    name = cache.digest(sequence, subject, training, settings)
    kept = cache.load(name)
    calibration = kept or calibrate(sequence, subject, training, views.source == "given", settings)
    if kept is None:
        cache.keep(name, calibration)
    return calibration.apply(settings), kept is not None


def _search(job: _Job, settings: EncodeSettings, goal: Goal, stage: Path) -> float:
    """The quality factor that brings the top rung to its goal."""
    top = replace(settings, levels=settings.levels[:1], core_levels=0)
    frames = settings.measure_frames or TRIAL_FRAMES
    trials = 0

    def trial(factor: float) -> float:
        nonlocal trials
        trials += 1
        job.progress(f"trial {trials}: quality factor {factor:.3g}", 0, 1)
        folder = stage / ".trial"
        folder.mkdir()
        try:
            manifest = job.encode(replace(top, quality=factor), folder)
            if goal.kind == PSNR:
                measured = pooled_quality(job.measure(manifest, folder, frames), 0, 0)
                assert measured is not None
                return measured.psnr
            tables = _table_bytes(manifest, len(settings.levels))
            return (manifest.bytes_of(manifest.rung_files(0, 0)) + tables) / manifest.frames / 1e3
        finally:
            shutil.rmtree(folder)

    return find_quality(goal, trial, settings.quality)


def _table_bytes(m: Manifest, levels: int) -> int:
    """Length of both manifests if the package had so many levels, each like the only one in `m`."""
    files = dict(m.files)
    for path, entry in m.files.items():
        files |= {path.replace("/L0/", f"/L{j}/"): entry for j in range(levels)}
    many = replace(
        m,
        levels=m.levels * levels,
        state_pictures=m.state_pictures * levels,
        groups=[replace(g, levels=g.levels * levels) for g in m.groups],
        segments=[replace(s, levels=s.levels * levels) for s in m.segments],
        files=files,
    )
    return len(many.to_json()) + len(write_mpd(many))
