"""From a sequence to a published package: decide, fold over groups, measure what came out, write the tables last."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import Executor
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from airgs_codec._arguments import argument, brief, path_argument
from airgs_codec.analysis.rows import Restored
from airgs_codec.decoder.decode import decode
from airgs_codec.encoder.decide import Surveys, choose
from airgs_codec.encoder.group import encode_run, fold
from airgs_codec.encoder.measure import measure, say_useless, with_quality
from airgs_codec.encoder.order import hold_frames, order_rows
from airgs_codec.encoder.plan import Choice, Plan
from airgs_codec.encoder.settings import DEFAULT_SETTINGS, EncodeSettings
from airgs_codec.encoder.survey import Frames
from airgs_codec.encoder.tables import GroupFiles, add_sound, build_manifest
from airgs_codec.encoder.target import Goal
from airgs_codec.errors import ConfigError, FormatError, SceneError
from airgs_codec.jobs.work import Work
from airgs_codec.media.h264 import library_versions
from airgs_codec.media.image import encode_jpeg, resize, to_bytes, to_floats
from airgs_codec.package.manifest import Manifest
from airgs_codec.package.mpd import LiveClock, check_shared
from airgs_codec.package.package import Package, find_faults, open_files, write_file
from airgs_codec.package.publish import staged_package, write_tables
from airgs_codec.package.region import opening_view
from airgs_codec.package.tables import MAX_POSTER_BYTES, MAX_POSTER_SIDE, Group
from airgs_codec.places.place import Folder, Storage, place_at
from airgs_codec.places.whole import expect_folder_name
from airgs_codec.progress import Progress, Stopwatch, as_reporter, silent
from airgs_codec.render import Camera
from airgs_codec.render.backend import Renderer, open_renderer
from airgs_codec.scene.camera import with_pixels
from airgs_codec.scene.sequence import GaussianSequence, open_sequence

PACKAGE_ENDING = ".airgs"  # of the names of packages, which may have none
RUN_VERSION = 2  # of what `encode_run` gives for the same frames and plan: stored results of others are made again
POSTER_QUALITIES = (90, 80, 70, 60, 50, 40, 30)  # of JPEG; a worse picture is made smaller instead


@dataclass(frozen=True, slots=True)
class EncodeReport:
    """A package that was encoded, how, and how many seconds each part of the work took."""

    manifest: Manifest
    manifest_bytes: int  # all tables and manifest.mpd together
    plan: Plan
    rows: Restored  # which frames were put into order
    encode_s: float
    measure_s: float

    __repr__ = brief

    def stages(self) -> list[Choice]:
        """List the parts of the work in their order: the choices of the plan, then what was done by it."""
        m, measured = self.manifest, "nothing"
        if m.rungs:
            error = max(quality.error for of_quality in m.rungs for quality in of_quality)
            measured = f"{m.views.measured} pictures; the standard error of no PSNR is above {error:.2f} dB"
        own = sum(group.base is None for group in m.groups)
        encoded = f"{len(m.groups)} groups, {own} of whose keyframes are coded by themselves"
        done = [Choice("encoding", encoded, self.encode_s), Choice("measuring", measured, self.measure_s)]
        return [*self.plan.choices, *done]


def encode(
    sequence: GaussianSequence | str | Path,
    path: str | Path,
    settings: EncodeSettings = DEFAULT_SETTINGS,
    *,
    goal: Goal | None = None,
    plan: Plan | None = None,
    executor: Executor | None = None,
    work: str | Path | None = None,
    progress: Progress | type = silent,
) -> EncodeReport:
    """Encode a sequence, open or at a path, and publish it as the package at `path`, whole or not at all.

    `path` is a folder or an address; a package that is there already is replaced. `goal`: see `decide`. `plan`: what
    `decide` gave, in place of settings and a goal. `executor`: runs of groups are encoded by it, by default by this
    process. `work`: a folder or an address where finished runs are stored, so that an encode that is cut off can go on.
    `progress`: a function, or a class of bars such as tqdm.auto.tqdm. The bytes are the same whoever does the work.

    Raises SceneError for a scene that cannot be coded, CodecError when the video encoder fails, and ConfigError for a
    margin below 0, a goal out of reach or a `path` with other files in it; then `path` is as it was. TransportError for
    an object store that does not answer, WorkError for workers that die.
    """
    sequence = argument("sequence", sequence, GaussianSequence, "an open sequence or the path of one", open_sequence)
    settings = argument("settings", settings, EncodeSettings, "EncodeSettings") if plan is None else plan.settings
    if goal is not None:
        argument("goal", goal, Goal, "a Goal")
        if plan is not None:
            raise ConfigError("goal: expected none with a plan, whose quality is chosen")
    expect_folder_name(path_argument("path", path), PACKAGE_ENDING)
    jobs, sequence = Work.of(executor, work, as_reporter(progress)), hold_frames(sequence)
    with staged_package(place_at(path)) as stage, closing(sequence):
        watch, place = Stopwatch(), Folder(stage)
        surveys: Surveys = {}
        ordered = order_rows(sequence, settings.rows, jobs.progress)
        if plan is None:
            plan, surveys = choose(ordered, settings, goal, jobs.progress)
        plan = plan.of(ordered.sequence)
        watch.lap()
        tables = []
        for number, group in encode_groups(ordered.sequence, plan, jobs, surveys):
            tables.append((number, group.table))
            for name, data in group.files.items():
                write_file(place, name, data)
        manifest = finish(place, ordered.sequence, plan, [table for _, table in sorted(tables, key=lambda one: one[0])])
        encode_s = watch.lap()
        manifest = measured(place, manifest, ordered.sequence, plan, jobs.progress)
        measure_s = watch.lap()
        size = write_checked(place, manifest)
        jobs.progress("encoding", len(plan.groups), len(plan.groups))
    return EncodeReport(manifest, size, plan, ordered.restored, encode_s, measure_s)


def encode_groups(
    sequence: GaussianSequence, plan: Plan, jobs: Work, surveys: Surveys
) -> Iterator[tuple[int, GroupFiles]]:
    """Encode all groups and give each, with its number, when it is there: in order, but for runs that are jobs."""
    if not jobs.elsewhere:
        groups = plan.frames(sequence)
        jobs.progress("encoding", 0, len(groups))
        for done, (frames, group) in enumerate(zip(groups, fold(groups, plan, surveys), strict=True), 1):
            jobs.progress(f"encoding: {frames.words}", done, len(groups))
            yield frames.number, group
        return
    runs = list(plan.runs(sequence))
    contents = [content_of(run, plan) for run in runs] if jobs.store else None
    for place, encoded in jobs.map("encoding", encode_run, [(run, plan) for run in runs], contents, RUN_VERSION):
        yield from zip((frames.number for frames in runs[place]), encoded, strict=True)


def content_of(run: Sequence[Frames], plan: Plan) -> list[Any]:
    """Give all that decides the files of a run, to name its stored result by."""
    sequence, first = run[0].sequence, run[0]
    frames = range(first.start, run[-1].stop)
    settings = replace(plan.settings, threads=1, device="auto", measure_pictures=0)
    named = replace(plan, settings=settings, groups=(), begins=(), notes=(), choices=())
    spans = [(part.number, part.spans, sequence.usage(*part.spans[0])) for part in run]
    return [library_versions(), named, spans, first.first_segment, sequence.fps, [sequence.read(n) for n in frames]]


def finish(place: Storage, sequence: GaussianSequence, plan: Plan, groups: Sequence[Group]) -> Manifest:
    """Make the tables of a package whose groups are at a place, and write the files that are no group's."""
    first = opening_view(plan.views.region, plan.views.world)
    poster = draw_poster(sequence, 0, first, open_renderer(plan.settings.device))
    manifest, shared = build_manifest(plan, sequence, sequence.attribution, groups, poster)
    if sequence.sound_track:
        manifest, files = add_sound(manifest, sequence.sound_track)
        shared |= files
    for path, data in shared.items():
        write_file(place, path, data)
    return manifest


def measured(
    place: Storage, m: Manifest, sequence: GaussianSequence, plan: Plan, progress: Progress = silent
) -> Manifest:
    """Measure a package whose files are at a place, all but its tables, unless the settings say not to."""
    if not plan.settings.measure_pictures:
        return m
    progress("measuring", 0, 1)
    renderer, package = open_renderer(plan.settings.device), Package(place, m, 0)
    most, segments = plan.settings.measure_pictures, range(len(m.segments))
    seen = measure(package, sequence, plan.views, renderer, most, segments)
    progress("measuring", 1, 1)
    return say_useless(with_quality(m, [seen]))


@contextmanager
def held_to_readers() -> Iterator[None]:
    """Make a SceneError of a refusal of what the block writes: nobody else could read it either."""
    try:
        yield
    except FormatError as error:
        raise SceneError(f"the package cannot be read back, and is not published: {error}") from error


def write_checked(place: Storage, manifest: Manifest, clock: LiveClock | None = None) -> int:
    """Write the tables of a package, whose other files are there; gives the length of tables and manifest.mpd together.

    `clock`: of a package that grows. Raises SceneError where what is there then is not what the tables say, or its
    first and last frame cannot be decoded.
    """
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


def draw_poster(sequence: GaussianSequence, frame: int, camera: Camera, renderer: Renderer) -> bytes:
    """Draw a JPEG of what a camera sees of a frame, as good, and then as large, as MAX_POSTER_BYTES allow."""
    share = MAX_POSTER_SIDE / max(camera.width, camera.height)
    shown = with_pixels(camera, *(max(1, round(share * side)) for side in (camera.width, camera.height)))
    picture = to_bytes(renderer.render(sequence.load([frame]).frames[0], shown).rgb)
    while True:
        for quality in POSTER_QUALITIES:
            data = encode_jpeg(picture, quality)
            if len(data) <= MAX_POSTER_BYTES:
                return data
        height, width = (side * 3 // 4 for side in picture.shape[:2])
        picture = to_bytes(resize(to_floats(picture), width, height))
