"""From a sequence to a published package: look, survey, calibrate, encode, measure, write the manifests last."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, contextmanager, nullcontext
from dataclasses import dataclass, replace
from pathlib import Path

from airgs_codec._arguments import argument, brief, path_argument
from airgs_codec.analysis.rows import Restored
from airgs_codec.decoder.decode import decode
from airgs_codec.encoder.batch import Encoded, EncodeProgress, calibrate_sequence, measure_encoded
from airgs_codec.encoder.measure import Measured, uncertainty_db
from airgs_codec.encoder.prepare import hold_frames, order_rows, prepare
from airgs_codec.encoder.repair import encode_repaired
from airgs_codec.encoder.search import DELTA_E, Goal, search_quality, weigh_colours
from airgs_codec.encoder.settings import DEFAULT_SETTINGS, EncodeSettings
from airgs_codec.encoder.survey import plan_views
from airgs_codec.encoder.tables import add_sound
from airgs_codec.errors import FormatError, SceneError
from airgs_codec.jobs.job import Record
from airgs_codec.jobs.work import Work, temporary_work
from airgs_codec.package.manifest import Manifest
from airgs_codec.package.mpd import LiveClock, check_shared
from airgs_codec.package.package import find_faults, open_files, write_file
from airgs_codec.package.publish import staged_package, write_tables
from airgs_codec.places.place import Folder, Place, place_at
from airgs_codec.places.whole import expect_folder_name
from airgs_codec.progress import Progress, Stopwatch, silent, told
from airgs_codec.scene.sequence import GaussianSequence, open_sequence
from airgs_codec.trainer.track import decide, tracked

ENDING = ".airgs"  # of the names of packages, which may have none
NO_FILES: Mapping[str, bytes] = {}


@dataclass(frozen=True, slots=True)
class Stage:
    """A part of the work of an encode."""

    name: str
    seconds: float
    bought: str  # what came of it, for people


@dataclass(frozen=True, slots=True)
class EncodeReport:
    """A package that was encoded, and how many seconds each part of the work took."""

    manifest: Manifest
    manifest_bytes: int  # all tables and manifest.mpd together
    rows: Restored  # which frames were put into order
    rows_s: float
    survey_s: float  # views and lengths of groups
    calibrate_s: float
    search_s: float  # for a goal
    encode_s: float
    measure_s: float
    cached: bool  # the calibration was found before
    records: Sequence[Record] = ()  # of the jobs
    saved: float = 0.0  # bytes a frame, as in `Calibration`
    goal: Goal | None = None
    trials: Sequence[tuple[float, float]] = ()  # of the search: quality factors, and what they came to
    repairs: Sequence[str] = ()  # why it was encoded again, a line each
    uncertainty: float = 0.0  # as in `Measured`

    __repr__ = brief

    def stages(self) -> list[Stage]:
        """The parts of the work in their order, and what came of each."""
        m, longest = self.manifest, max(group.stop - group.start for group in self.manifest.groups)
        top = m.bytes_of(m.rung_files(0, 0)) / m.frames
        steps, trials, measured = "nothing", "no goal was given", "nothing"
        if self.saved:
            steps = f"steps that save about {100 * self.saved / (self.saved + top):.0f} % of the bytes at equal error"
            steps += ", which an earlier run found" if self.cached else ""
        if self.goal:
            first, last = self.trials[0][1], self.trials[-1][1]
            wanted = f"{self.goal.value:g} {self.goal.metric.name}"
            trials = f"{len(self.trials)} trials for {wanted}, from {first:.4g} to {last:.4g}"
        if m.measured:
            measured = f"a claim {certainty_words(self.uncertainty)}, by pictures of each segment: {m.views.measured}"
        return [
            Stage("order of rows", self.rows_s, f"{len(self.rows.matched)} frames were put in order"),
            Stage("views and lengths of groups", self.survey_s, f"{len(m.groups)} groups of up to {longest} frames"),
            Stage("calibration", self.calibrate_s, steps),
            Stage("search", self.search_s, trials),
            Stage("encoding", self.encode_s, "; ".join(self.repairs) or "the package, at the first attempt"),
            Stage("measuring", self.measure_s, measured),
        ]


def certainty_words(uncertainty: float) -> str:
    """How far a claim may be off; a single picture does not tell."""
    if math.isinf(uncertainty):
        return "of a single picture, which does not tell how sure it is"
    return f"good to {uncertainty_db(uncertainty):.1f} dB"


def encode(
    sequence: GaussianSequence | str | Path,
    path: str | Path,
    settings: EncodeSettings = DEFAULT_SETTINGS,
    *,
    goal: Goal | None = None,
    work: Work | None = None,
    progress: Progress | type = silent,
) -> EncodeReport:
    """Encode a sequence, open or at a path, and publish it as the package at `path`, whole or not at all.

    `path` is a folder or an address; a package that is there already is replaced. `goal`: a quality factor is searched
    for that brings the top rung to this PSNR or size; `settings.quality` is where the search starts. `work`: who does
    the jobs, and where their results stay, by default this process, which tells `progress`, and a folder that is
    removed. `progress`: a function, or a class of bars such as tqdm.auto.tqdm. The bytes are the same whoever does the
    work.

    Raises SceneError for a scene that cannot be coded, CodecError when the video encoder fails, and ConfigError for a
    margin below 0, a goal out of reach or a `path` with other files in it; then `path` is as it was. TransportError for
    an object store that does not answer, WorkError for workers that die.
    """
    sequence = argument("sequence", sequence, GaussianSequence, "an open sequence or the path of one", open_sequence)
    settings = argument("settings", settings, EncodeSettings, "EncodeSettings")
    if goal is not None:
        argument("goal", goal, Goal, "a Goal")
    expect_folder_name(path_argument("path", path), ENDING)
    working = temporary_work(told(progress)) if work is None else nullcontext(work)
    with staged_package(place_at(path)) as stage, working as at:
        return _encode(sequence, Folder(stage, alone=True), settings, goal, at)


def _encode(
    sequence: GaussianSequence, place: Place, settings: EncodeSettings, goal: Goal | None, work: Work
) -> EncodeReport:
    """Track a sequence where its settings say so, encode it and write its files to a place."""
    attribution, sound = sequence.attribution, sequence.sound_track
    with ExitStack() as stack:
        given, views, notes = hold_frames(sequence), None, []
        if settings.track is not False and decide(given, settings.track, settings.rows)[0]:
            plan = plan_views(given, settings)
            found, note = stack.enter_context(tracked(given, plan.deciding, plan.renderer, work))
            given, views, notes = found, plan if found is not given else None, [note]
        held = stack.enter_context(closing(hold_frames(given)))
        watch = Stopwatch()
        ordered, rows_s = order_rows(held, settings, work), watch.lap()
        original = prepare(ordered, settings, work, attribution, views)
        progress = EncodeProgress(work.progress, original, settings)
        work = replace(work, progress=progress)
        if goal and goal.metric == DELTA_E:
            settings = weigh_colours(settings, original)
        survey_s = watch.lap()
        calibrated, calibrate_s = calibrate_sequence(original, settings, work), watch.lap()
        chosen = calibrated.settings
        trials: list[tuple[float, float]] = []
        if goal:
            chosen, trials = search_quality(calibrated, original, goal, work)
            calibrated = replace(calibrated, expected=None)  # what costs too much was taken back before the search
        search_s = watch.lap()
        encoded, _, repairs = encode_repaired(calibrated, chosen, work, original)
        encode_s, measured = watch.lap(), Measured(encoded.manifest, math.inf)
        if settings.measure_pictures:
            measured = measure_encoded(encoded, original, settings.measure_pictures)
        measure_s = watch.lap()
        progress.end()
    decisions = [*notes, *measured.manifest.decisions, *calibrated.decisions, *repairs]
    manifest, files = replace(measured.manifest, decisions=decisions), NO_FILES
    if sound:
        manifest, files = add_sound(manifest, sound)
    size = write_package(place, encoded, manifest, more_files=files)
    return EncodeReport(
        manifest,
        size,
        replace(ordered.rows, sequence=given),
        rows_s,
        survey_s,
        calibrate_s,
        search_s,
        encode_s,
        measure_s,
        calibrated.cached,
        work.records(),
        calibrated.saved,
        goal,
        trials,
        repairs,
        measured.uncertainty,
    )


@contextmanager
def held_to_readers() -> Iterator[None]:
    """Nothing; a refusal of what the block writes becomes a SceneError: nobody else could read it either."""
    try:
        yield
    except FormatError as error:
        raise SceneError(f"the package cannot be read back, and is not published: {error}") from error


def write_package(
    place: Place,
    encoded: Encoded,
    manifest: Manifest,
    clock: LiveClock | None = None,
    more_files: Mapping[str, bytes] = NO_FILES,
) -> int:
    """Write all files of a package, its tables last; gives the length of tables and manifest.mpd together.

    `manifest`: its tables, measured. `clock`: of a package that grows. Raises SceneError where what is there then is
    not what the tables say, or its first and last frame cannot be decoded.
    """
    groups = (encoded.group(number).files for number in range(len(encoded.files)))
    for files in (encoded.shared, more_files, *groups):
        for path, data in files.items():
            write_file(place, path, data)
    with held_to_readers():
        size = write_tables(place, manifest, clock)
        package = open_files(place)
        for fault in find_faults(package).values():
            raise fault
        for path in manifest.shared_files():
            check_shared(package, path)
        for frame in {0, manifest.frames - 1}:
            decode(package, frame)
    return size
