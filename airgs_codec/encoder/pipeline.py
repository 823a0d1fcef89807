"""The steps by which a sequence is encoded, declared once: survey -> rows -> key -> differences -> states -> quality.

A step is a function of values, with nothing held between calls, and `STEPS` says what each reads and makes. Whoever
drives them only says where values come from: `PreparedSequence` makes a job of a step and a group, which an engine does
here or on a farm (`batch`); `do` calls it at once (`live`).
"""

from __future__ import annotations

import itertools
import tempfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from airgs_codec.analysis.importance import WrittenRows
from airgs_codec.coding.channels import Canonical
from airgs_codec.encoder.calibrate import Calibration, calibrate
from airgs_codec.encoder.keys import CodedKeys, code_keys, decode_keys, encode_keys, key_bytes, lay_out_again
from airgs_codec.encoder.measure import RungErrors, measure_group
from airgs_codec.encoder.omit import omit_bands
from airgs_codec.encoder.plan import GroupLayout, keep_rows, lay_out
from airgs_codec.encoder.representation import Clock, Representation
from airgs_codec.encoder.settings import EncodeSettings
from airgs_codec.encoder.states import code_states, encode_states
from airgs_codec.encoder.survey import GroupSpan, Pictures, Survey, ViewPlan, naming_farthest, survey_group
from airgs_codec.encoder.tables import CodedGroup, finish_group
from airgs_codec.jobs.job import Job, digest
from airgs_codec.media.image import encode_jpeg, resize, to_bytes, to_floats
from airgs_codec.package.package import Package, manifest_of
from airgs_codec.package.tables import MAX_POSTER_BYTES, MAX_POSTER_SIDE, Group, Root
from airgs_codec.places.place import Memory
from airgs_codec.places.whole import naming
from airgs_codec.render import Camera
from airgs_codec.render.backend import Renderer
from airgs_codec.scene.camera import with_pixels
from airgs_codec.scene.frames import Repaired, turn_least
from airgs_codec.scene.gaussians import SH_REST
from airgs_codec.scene.sequence import GaussianSequence

WORTH = 0.25  # share of a key's bytes that coding it as a difference must save
MORE = 0.25  # share of its rows that a group may have more than it needs, for those that differ from it
AHEAD = 16  # groups, itself among them, whose rows a group has so that others may differ from it
POSTER_QUALITIES = (90, 80, 70, 60, 50, 40, 30)  # of JPEG; a worse picture is made smaller instead


@dataclass(frozen=True, slots=True, eq=False)
class CodedKey:
    """A group whose key is coded: everything that its states need."""

    layout: GroupLayout
    keys: CodedKeys
    pictures: Sequence[Sequence[Representation]]  # key tier x key quality
    decoded: Sequence[Canonical]  # for each key quality
    bytes: int  # of all its key pictures and sidecars


@dataclass(frozen=True, slots=True, eq=False)
class GroupFiles:
    """A group as it goes into a package."""

    table: Group  # without measured quality
    files: Mapping[str, bytes]  # by path
    rows: NDArray[np.intp]  # (N,) input rows that are written, in file order
    depths: NDArray[np.uint8]  # (N,) deepest level that carries a row; STATIC: none


def choose_bands(
    sequence: GaussianSequence, survey: Survey, calibration: Calibration, settings: EncodeSettings
) -> tuple[int, str | None]:
    """Give the SH bands past DC that a scene needs at calibrated settings, and a line on the others."""
    return omit_bands(sequence, survey, calibration.apply(settings))


def choose_rows(sequence: GaussianSequence, survey: Survey, allowed: float | None) -> WrittenRows:
    """Give the rows that pictures of a group need, by `EncodeSettings.row_error`. Raises SceneError."""
    return keep_rows(_load(sequence, survey).frames, survey, allowed)


def with_rows_of_others(needed: Iterable[NDArray[np.intp]]) -> tuple[NDArray[np.intp], int]:
    """Give the rows of a key for several groups, and how many groups: those that the first needs, and the next ones.

    As long as they are AHEAD groups at most, and their rows at most MORE than the first needs.
    """
    groups = itertools.islice(needed, AHEAD)
    rows, count = next(groups), 1
    most = (1 + MORE) * len(rows)
    for some in groups:
        union = np.union1d(rows, some)
        if len(union) > most:
            break
        rows, count = union, count + 1
    return rows, count


def _load(sequence: GaussianSequence, survey: Survey) -> Repaired:
    return turn_least(sequence.load(range(survey.span.start, survey.span.stop)))


def code_key(sequence: GaussianSequence, survey: Survey, written: WrittenRows, settings: EncodeSettings) -> CodedKey:
    """Code the key of a group by itself.

    Raises SceneError for a group that cannot be coded, CodecError when the video encoder fails.
    """
    layout = lay_out(_load(sequence, survey), survey, written, settings, sequence.fps)
    with naming_farthest(sequence, survey.span):
        return _coded(layout, settings, sequence.fps, ())


def code_difference(
    sequence: GaussianSequence, survey: Survey, written: WrittenRows, of: CodedKey, settings: EncodeSettings
) -> CodedKey | None:
    """Code the key of a group as what differs from an earlier one, `of`.

    None where that saves too little, or where pictures need rows that the other does not have: more of those that are
    `written` than may be left out. Raises CodecError when the video encoder fails.
    """
    layout = lay_out_again(_load(sequence, survey), survey, written, of.layout, settings, sequence.fps)
    with naming_farthest(sequence, survey.span):
        coded = layout and _coded(layout, settings, sequence.fps, of.decoded)
    alone = of.bytes * len(written.rows) / len(of.layout.rows)
    return coded if coded and coded.bytes <= (1 - WORTH) * alone else None


def _coded(layout: GroupLayout, settings: EncodeSettings, fps: Fraction, base: Sequence[Canonical]) -> CodedKey:
    """The coded key of a group; `base`: the canonical spaces that it is a difference to, if it is one."""
    keys = code_keys(layout, settings, base)
    pictures = encode_keys(layout, keys, Clock.of(fps), settings)
    spaces: Sequence[Canonical | None] = base or [None] * len(settings.key_factors)
    decoded = [decode_keys(layout, keys, pictures, settings, q, space) for q, space in enumerate(spaces)]
    return CodedKey(layout, keys, pictures, decoded, key_bytes(layout, keys, pictures))


def code_group(sequence: GaussianSequence, key: CodedKey, settings: EncodeSettings, first_segment: int) -> GroupFiles:
    """Make the files and the table of a group whose key is coded.

    `first_segment`: how many segments the groups before it have.

    Raises SceneError for a group that cannot be coded, CodecError when the video encoder fails.
    """
    layout = key.layout
    frames = turn_least(sequence.load(range(layout.span.start, layout.span.stop))).frames
    with tempfile.TemporaryDirectory(prefix="airgs-") as scratch, naming(Path(scratch)):
        clock = Clock.of(sequence.fps)
        with naming_farthest(sequence, layout.span):
            states = code_states(layout, key.decoded, frames, settings, clock, Path(scratch))
        pictures = encode_states(layout, states, clock, settings)
        coded = CodedGroup(layout, key.keys, states, key.pictures, pictures, first_segment)
        table, files = finish_group(coded)
    return GroupFiles(table, files, layout.rows, states.depths)


def measure_files(
    original: GaussianSequence,
    renderer: Renderer,
    tables: tuple[Root, Sequence[Group]],
    pictures: Sequence[Pictures],
    own: GroupFiles,
    base: GroupFiles | None,
) -> RungErrors:
    """Measure a group in some pictures of each segment, from its files and those of the group that it differs from.

    `tables`: those of the package.
    """
    files = {**own.files, **(base.files if base else {})}
    package = Package(Memory("encoded groups", files), manifest_of(*tables), 0)
    number = [table.start for table in tables[1]].index(own.table.start)
    return measure_group(package, original, renderer, number, pictures)


def draw_poster(sequence: GaussianSequence, frame: int, camera: Camera, renderer: Renderer) -> bytes:
    """Return a JPEG of what a camera sees of a frame, as good, and then as large, as MAX_POSTER_BYTES allow."""
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


@dataclass(frozen=True, slots=True)
class Read:
    value: Any  # may be `Stored`: the result of another step
    name: Any  # tells it from any other: plain values that `digest` takes


NOTHING = Read(None, None)
NONE_GIVEN: Mapping[str, Read] = {}


def made_by(job: Job) -> Read:
    """Give the result of a job to another step."""
    return Read(job.result, job.entry)


@dataclass(frozen=True, slots=True)
class Step:
    """A step of encoding: its function, called with what it reads, gives what it makes."""

    name: str  # for people, and in the names of results
    function: Callable[..., Any]
    reads: tuple[str, ...]  # its arguments in their order: what other steps make, or what is given
    makes: str

    def job(self, label: str, known: Mapping[str, Read]) -> Job:
        """Name the result of the step by the content of all that it reads; `label` says to people which frames."""
        reads = [known[name] for name in self.reads]
        names, values = [read.name for read in reads], tuple(read.value for read in reads)
        return Job.of(self.name, label, self.function, values, names)

    def do(self, known: dict[str, Any]) -> Any:
        """Take the step here and now; what it makes is returned, and known from then on."""
        known[self.makes] = self.function(*(known[name] for name in self.reads))
        return known[self.makes]


SURVEY = Step("survey", survey_group, ("sequence", "span", "views"), "survey")
CALIBRATION = Step("calibration", calibrate, ("sequence", "survey", "settings"), "calibration")
BANDS = Step("SH bands", choose_bands, ("sequence", "survey", "calibration", "settings"), "bands")
ROWS = Step("rows", choose_rows, ("sequence", "survey", "row_error"), "written")
KEY = Step("keys", code_key, ("sequence", "survey", "written", "settings"), "key")
DIFFERENCE = Step("differences", code_difference, ("sequence", "survey", "written", "base", "settings"), "difference")
STATES = Step("states", code_group, ("sequence", "coded", "settings", "first_segment"), "files")
QUALITY = Step(
    "quality", measure_files, ("sequence", "renderer", "tables", "pictures", "files", "base_files"), "errors"
)
POSTER = Step("poster", draw_poster, ("sequence", "frame", "camera", "renderer"), "poster")
STEPS = {step.makes: step for step in (SURVEY, CALIBRATION, BANDS, ROWS, KEY, DIFFERENCE, STATES, QUALITY, POSTER)}


@dataclass(frozen=True, eq=False)
class PreparedSequence:
    """A sequence that is ready to be encoded: its rows are in order, its frames named, groups split and views drawn."""

    sequence: GaussianSequence
    names: tuple[str, ...]  # SHA-256 of all frames of the sequence as they are in their files
    groups: Sequence[tuple[int, int]]  # frames [start, stop) of each
    views: ViewPlan
    notes: tuple[str, ...] = ()  # on rows and groups, for people
    attribution: str = ""
    together: int | None = None  # bytes of frames that are held while groups are encoded; None: nobody holds any

    def __len__(self) -> int:
        return len(self.groups)

    @cached_property
    def spans(self) -> tuple[GroupSpan, ...]:
        return tuple(GroupSpan(index, *group) for index, group in enumerate(self.groups))

    @cached_property
    def windows(self) -> tuple[range, ...]:
        """Groups that are taken through all steps together, as many as are held, so that no frame is read again."""
        starts, size = [0], 0
        for span in self.spans if self.together is not None else ():
            headers = self.sequence.headers[span.start : span.stop]
            own = sum(4 * header.count * (14 + 3 * SH_REST[header.sh_degree]) for header in headers)
            if size and size + own > (self.together or 0):
                starts.append(span.index)
                size = 0
            size += own
        return tuple(itertools.starmap(range, itertools.pairwise([*starts, len(self.spans)])))

    def job(
        self, step: Step, group: int, settings: EncodeSettings | None = None, given: Mapping[str, Read] = NONE_GIVEN
    ) -> Job:
        """Make a job of a step for a group; what it reads is `given`, or else made by the step that makes it.

        What only decides how fast a job is done (threads), or where files lie, does not count in the name of its
        result.
        """
        span = self.spans[group]
        known = {
            "sequence": Read(self.sequence, self.contents[group]),
            "span": Read(span, span),
            "views": Read(self.views, self._seen),
            "renderer": Read(self.views.renderer, self.views.renderer),
            **(
                {"settings": chosen(settings), "row_error": Read(settings.row_error, settings.row_error)}
                if settings
                else {}
            ),
            **given,
        }
        for name in step.reads:
            if name not in known:
                known[name] = made_by(self.job(STEPS[name], group, settings))
        return step.job(f"frames {span.start}-{span.stop - 1}", known)

    @cached_property
    def contents(self) -> tuple[str, ...]:
        """The names of all frames of each group as they are read, and of what the trainer measured of them."""
        return tuple(self._content(span) for span in self.spans)

    def _content(self, span: GroupSpan) -> str:
        s = self.sequence
        orders = [s.orders.get(frame) for frame in range(span.start, span.stop)]
        usage = s.usage(span.start, span.stop)
        return digest(self.names[span.start : span.stop], orders, s.sh_degree, s.fps, usage, span)

    @cached_property
    def _seen(self) -> str:
        return seen(self.views)


def seen(views: ViewPlan) -> str:
    """Name what decides in a plan of views."""
    return digest(views.deciding, views.decided, views.trusted, views.renderer)


def chosen(settings: EncodeSettings) -> Read:
    """Settings, named without those that decide nothing about the files of a group."""
    same = replace(settings, threads=1, device="auto", measure_pictures=0, region=None, margin=None, world=None)
    return Read(settings, same)
