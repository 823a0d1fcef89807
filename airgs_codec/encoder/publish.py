"""From a sequence to a published package: look, survey, calibrate, encode, check, measure, write the manifests last."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

from airgs_codec._arguments import argument
from airgs_codec.analysis.rows import Restored
from airgs_codec.encoder.batch import EncodeProgress, calibrate_sequence
from airgs_codec.encoder.doubt import doubt_db
from airgs_codec.encoder.measure import Rounds
from airgs_codec.encoder.pipeline import GroupFiles
from airgs_codec.encoder.prepare import hold_frames, order_rows, prepare
from airgs_codec.encoder.search import DELTA_E, Goal, search_quality, weigh_colours
from airgs_codec.encoder.settings import DEFAULT_LEVELS, DEFAULT_SETTINGS, EncodeSettings
from airgs_codec.encoder.tables import add_sound
from airgs_codec.encoder.track import Tracked, tracked
from airgs_codec.encoder.verify import Attempt, Verified, encode_verified
from airgs_codec.errors import WorkError
from airgs_codec.jobs.job import Record, Stored, code_digest, read_result
from airgs_codec.jobs.work import Work, temporary_work
from airgs_codec.media.sound import SoundTrack
from airgs_codec.package.manifest import Manifest
from airgs_codec.package.mpd import LiveClock
from airgs_codec.package.package import manifest_of, root_of, write_file
from airgs_codec.package.publish import staged_package, write_tables
from airgs_codec.package.tables import Group, Root
from airgs_codec.places.place import Folder, Place, place_at
from airgs_codec.places.results import Store, pack, unpack
from airgs_codec.progress import Progress, Stopwatch, silent, told
from airgs_codec.scene.sequence import GaussianSequence, open_sequence

PACKAGE_ENTRY = "package"  # of a store: what the last encode that was whole came to


@dataclass(frozen=True, slots=True)
class Beside:
    """What goes into a package beside frames."""

    attribution: str
    sound: SoundTrack | None


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
    trials: Sequence[tuple[float, float]] = ()  # as in `Attempt`
    repairs: Sequence[str] = ()  # why it was encoded again, a line each
    unsure: float = 0.0  # as in `Measured`

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
            measured = f"a claim {doubt_words(self.unsure)}, by pictures of each segment: {m.views.measured}"
        return [
            Stage("order of rows", self.rows_s, f"{len(self.rows.matched)} frames were put in order"),
            Stage("views and lengths of groups", self.survey_s, f"{len(m.groups)} groups of up to {longest} frames"),
            Stage("calibration", self.calibrate_s, steps),
            Stage("search", self.search_s, trials),
            Stage("encoding", self.encode_s, "; ".join(self.repairs) or "the package, at the first attempt"),
            Stage("measuring", self.measure_s, measured),
        ]


def doubt_words(unsure: float) -> str:
    """How far a claim may be off; one picture of each segment does not tell."""
    return "whose doubt is not known" if math.isinf(unsure) else f"good to {doubt_db(unsure):.1f} dB"


@dataclass(frozen=True, slots=True, eq=False)
class Finished:
    """A package whose files are results of jobs: all that is left is to write it."""

    root: Root
    groups: Sequence[Group]
    shared: Mapping[str, bytes]  # files that are no group's
    entries: Sequence[str]  # of a store: the `GroupFiles` of each group

    def write(self, store: Store, place: Place, clock: LiveClock | None = None) -> int:
        """Write all files, tables last; gives the length of tables and manifest.mpd together.

        `clock`: of a package that grows. Raises WorkError where results are gone from the store.
        """
        for path, data in self.shared.items():
            write_file(place, path, data)
        for entry in self.entries:
            group = read_result(store, Stored(entry))
            if not isinstance(group, GroupFiles):
                raise WorkError(f"{store.name}: expected the files of a group, got another result")
            for path, data in group.files.items():
                write_file(place, path, data)
        return write_tables(place, manifest_of(self.root, self.groups), clock)


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
    with staged_package(place_at(path)) as stage, _at(work, progress) as at:
        report, finished = _encode(sequence, settings, goal, at)
        at.store.write(PACKAGE_ENTRY, pack((code_digest(encode), finished)))
        return replace(report, manifest_bytes=finished.write(at.store, Folder(stage)))


def encode_part(
    sequence: GaussianSequence,
    settings: EncodeSettings,
    work: Work,
    *,
    goal: Goal | None = None,
) -> EncodeReport:
    """Do the jobs of `encode` without publishing anything; `merge` does that from the store of `work`.

    Several runs with the same store share the jobs: `work.part` says which come first here. Each ends when all are
    done, and does those that nobody else has done. Raises what `encode` raises.
    """
    work.store.write(PACKAGE_ENTRY, pack((code_digest(encode), None)))  # what was there is not this package
    report, finished = _encode(sequence, settings, goal, work)
    work.store.write(PACKAGE_ENTRY, pack((code_digest(encode), finished)))
    return report


def merge(store: Store, path: str | Path) -> tuple[Manifest, int]:
    """Publish what `encode_part` has left in a store; the tables, and the length of tables and manifest.mpd together.

    Raises WorkError where there is no whole package, and what `encode` raises for `path`.
    """
    finished = _last_package(store)
    with staged_package(place_at(path)) as stage:
        size = finished.write(store, Folder(stage))
    return manifest_of(finished.root, finished.groups), size


def _last_package(store: Store) -> Finished:
    data = store.read(PACKAGE_ENTRY)
    try:
        code, finished = (code_digest(encode), None) if data is None else unpack(data)
    except (TypeError, ValueError):
        code, finished = "", None
    if code != code_digest(encode):
        raise WorkError(f"{store.name}: expected a work folder of this version of airgs-codec, got one of another")
    if not isinstance(finished, Finished):
        raise WorkError(f"{store.name}: expected a work folder with all parts of a package, which no part has finished")
    return finished


@contextmanager
def _at(work: Work | None, progress: Progress | type) -> Iterator[Work]:
    if work is not None:
        yield work
        return
    with temporary_work(told(progress)) as at:
        yield at


def _encode(
    sequence: GaussianSequence,
    settings: EncodeSettings,
    goal: Goal | None,
    work: Work,
) -> tuple[EncodeReport, Finished]:
    beside = Beside(sequence.attribution, sequence.sound_track)
    with tracked(hold_frames(sequence), settings, work) as found:
        return _encode_rows(found, settings, goal, beside, work)


def _encode_rows(
    tracked: Tracked, settings: EncodeSettings, goal: Goal | None, beside: Beside, work: Work
) -> tuple[EncodeReport, Finished]:
    watch, sequence = Stopwatch(), tracked.sequence
    held = hold_frames(sequence)
    with closing(held):
        ordered, rows_s = order_rows(held, settings, work), watch.lap()
        original = prepare(ordered, settings, work, beside.attribution, tracked.views)
        whole = EncodeProgress(work.progress, original, settings)
        work = replace(work, progress=whole)
        if goal and goal.metric == DELTA_E:
            settings = weigh_colours(settings, original)
        survey_s = watch.lap()
        found, calibrate_s = calibrate_sequence(original, settings, work), watch.lap()
        rounds, given = Rounds(settings.measure_pictures), settings.levels != DEFAULT_LEVELS
        attempt = Attempt(found.prepared, original, found.settings, work, found.expected, rounds, given)
        if goal:
            attempt = search_quality(attempt, goal)
        search_s = watch.lap()
        verified = encode_verified(attempt)
        whole.end()
    decisions = [*tracked.notes, *verified.manifest.decisions, *found.decisions, *verified.stories]
    manifest = replace(verified.manifest, decisions=decisions)
    seconds = (rows_s, survey_s, calibrate_s, search_s, verified.encode_s, verified.measure_s)
    rows = replace(ordered.rows, sequence=sequence)
    finished = finish(verified, manifest)
    if beside.sound:
        manifest, files = add_sound(manifest, beside.sound)
        groups, shared = list(manifest.groups), {**finished.shared, **files}
        finished = replace(finished, root=root_of(manifest), groups=groups, shared=shared)
    told = (found.saved, goal, attempt.trials, verified.stories, verified.unsure)
    return EncodeReport(manifest, 0, rows, *seconds, found.cached, work.records(), *told), finished


def finish(verified: Verified, manifest: Manifest) -> Finished:
    """A verified package with tables that say so."""
    encoded = verified.encoded
    entries = [one.entry for one in encoded.files]
    return Finished(root_of(manifest), list(manifest.groups), encoded.shared, entries)
