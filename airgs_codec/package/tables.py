"""The tables of a package as frozen values: airgs.json (the root), the pages of its index, and a table a group.

FORMAT.md says what each field means. What else a field must be is a constraint in its annotation; `parse`
reads the JSON back and refuses everything else. `manifest` is a package's tables as one value.
"""

from __future__ import annotations

import base64
import hashlib
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Annotated

from airgs_codec.errors import ConfigError
from airgs_codec.scene.gaussians import SH_REST

VERSION = 6

MAX_COUNT = 1 << 24  # Gaussians a group
MAX_FRAMES = 100_000_000  # 38 days at 30 frames a second
MAX_SIDE = 16384  # pixels, either side of a view
MAX_PICTURE_SIDE = 4096  # samples
MIN_PICTURE_SIDE = 64  # smaller pictures trip encoders
MAX_MACROBLOCKS = 36_864  # of 16x16 samples, in a picture: H.264 level 5.1
MAX_PAGES = 128
MAX_FILE_BYTES = 1 << 31
MAX_POSTER_BYTES, MAX_POSTER_SIDE = 20_000, 640  # pixels, of the longer side
MAX_CHOICES = 64  # tiers, qualities, levels
MAX_PLACES = 64
GRID_BITS = 21  # of a grid index
MAX_CENTRE = 1 << 30  # so that a centre, a luma level and the base of an escape add up within int32
MAX_PSNR = 1000.0  # dB; nothing measured comes near, and ten to the power of a tenth of it is still a float
MAX_DELTA_E = 1000.0  # CIEDE2000; the largest of two sRGB colours is about 120
BLOCK = 16  # samples, either side of the blocks that a plane is made of
PAGE = 64  # groups, or pages of the level below, on a page of the index
MAX_LEVELS = 5  # of the index, groups among them: PAGE ** MAX_LEVELS groups have more than MAX_FRAMES frames
DIGEST = 32  # characters of a digest
PACKETS = 50  # of sound, a second
DELTA_ATTRIBUTES = ("means", "quaternions", "log_scales", "opacity", "sh_dc", "sh_rest")
KEYFRAME_ATTRIBUTES = DELTA_ATTRIBUTES[1:]  # canonical means travel in the sidecar
STATIC = 255  # depth of a row that no level carries; no depth is larger
LEAST_CLASS, MOST_CLASS = -128, 127  # of motion: a row of class c has the motion unit 2^c world units
MOST_WIDER = 255  # e of a row that lies in a grid 2^e times as wide
TRANSFORM_UNITS = 32767  # entries of a colour transform are whole numbers of 1 / 32767


@dataclass(frozen=True, slots=True)
class Range:
    low: float  # both bounds are included
    high: float


@dataclass(frozen=True, slots=True)
class Length:
    low: int  # how many values a list may have
    high: int


@dataclass(frozen=True, slots=True)
class OneOf:
    words: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Pattern:
    expression: str  # that matches a text from its start to its end
    what: str  # such texts are, for people


Digest = Annotated[str, Pattern("([A-Za-z0-9_-]{32})?", "a digest of 32 characters of base64url")]  # "": no file
Digests = Annotated[str, Pattern("([A-Za-z0-9_-]{32})*", "digests of 32 characters of base64url each")]
Count = Annotated[int, Range(0, MAX_COUNT)]
FrameNumber = Annotated[int, Range(0, MAX_FRAMES)]
FrameCount = Annotated[int, Range(1, MAX_FRAMES)]
PictureBytes = Annotated[int, Range(1, MAX_FILE_BYTES)]
Side = Annotated[int, Range(0, MAX_PICTURE_SIDE)]
Ticks = Annotated[int, Range(1, 1 << 31)]
Factor = Annotated[float, Range(1e-6, 1e6)]
Step = Annotated[float, Range(1e-30, 1e30)]
Gain = Annotated[float, Range(1e-3, 128)]
Decibels = Annotated[float, Range(-MAX_PSNR, MAX_PSNR)]
Point = Annotated[list[Annotated[float, Range(-1e30, 1e30)]], Length(3, 3)]
Colour = Annotated[list[Annotated[float, Range(0, 1)]], Length(3, 3)]
PlaceName = Annotated[str, Pattern(r"[^\x00-\x1f]{1,64}", "1 to 64 characters, none of control")]
Choices = Length(1, MAX_CHOICES)


@dataclass(frozen=True, slots=True)
class FileEntry:
    """Length and digest of a file; 0 and no digest where there is no file."""

    bytes: Annotated[int, Range(0, MAX_FILE_BYTES)]
    sha256: Digest


NO_FILE = FileEntry(0, "")


@dataclass(frozen=True, slots=True)
class Sound:
    """The Opus track of a package."""

    channels: Annotated[int, Range(1, 2)]
    pre_skip: Annotated[int, Range(0, (1 << 16) - 1)]  # samples at 48 kHz before the first one that is heard
    init: FileEntry  # sound/init.m4a, for DASH players alone


@dataclass(frozen=True, slots=True)
class Generator:
    """Who wrote the package and with what."""

    version: str
    libraries: dict[str, str]
    settings: dict[str, str]


@dataclass(frozen=True, slots=True)
class Place:
    """A ball of positions that a scene may be looked at from, and where a viewer there looks."""

    position: Point  # of the centre, world units
    focus: Point  # the point that a viewer looks at, world units
    up: Point  # a direction that points up in the picture
    reach: Annotated[float, Range(0, 1e30)]  # radius, world units
    name: PlaceName | None = None  # by which viewers find it; None, and no such field: it has none


@dataclass(frozen=True, slots=True)
class Region:
    """Where the scene may be looked at from: in the ball of a place, at most `turn` off the direction to its focus."""

    source: Annotated[str, OneOf(("cameras", "found", "orbit", "file"))]  # what it was made of
    width: Annotated[int, Range(1, MAX_SIDE)]  # pixels of the views that decisions and quality were measured with
    height: Annotated[int, Range(1, MAX_SIDE)]
    fov_y: Annotated[float, Range(0.1, 179)]  # their vertical field of view, degrees
    near: Annotated[float, Range(1e-30, 1e30)]  # world units: Gaussians nearer than this along the axis are not drawn
    turn: Annotated[float, Range(0, 180)]  # degrees
    places: Annotated[list[Place], Length(1, MAX_PLACES)]
    background: Colour | None = None  # r, g, b behind the scene; None, and no such field in airgs.json: black


@dataclass(frozen=True, slots=True)
class World:
    """Where the scene stands in a right-handed world with y up, as that of glTF: for players, not for decoders."""

    # Three rows of a turn, times a scale, with a shift: x in the world = row 0 · (x, y, z, 1).
    transform: Annotated[list[Annotated[float, Range(-1e30, 1e30)]], Length(12, 12)]
    metric: bool  # whether a unit of that world is a metre; false: nobody knows how long it is


@dataclass(frozen=True, slots=True)
class Views:
    """How many pictures were looked at."""

    decided: Count  # of each group, to decide what matters
    measured: Count  # the most that measured a rung: other views than those
    reference: Annotated[str, OneOf(("original", "none"))]  # the unpruned input; none: quality was not measured


@dataclass(frozen=True, slots=True)
class KeyframeQuality:
    """A keyframe quality: steps multiplied by `factor`, the sides of the cells of canonical means by 2^coarser."""

    id: str
    factor: Factor
    coarser: Annotated[int, Range(0, GRID_BITS)]  # ascending; 0 for the first


@dataclass(frozen=True, slots=True)
class Level:
    """A pruning level: which share of the moving rows is withheld at least, and the step factor of the others."""

    id: str
    pruned: Annotated[float, Range(0, 1)]  # of the moving rows
    factor: Factor
    tiers: int  # keyframe tiers that its viewers fetch; rows of later tiers have no delta in it
    quality: Annotated[int, Range(0, MAX_CHOICES - 1)]  # keyframe quality that its deltas correct


@dataclass(frozen=True, slots=True)
class Grid:
    """Nested cubic cells of canonical means: a row of motion class c lies in the middle of a cell of 2^k steps.

    k = c - finest, from 0 to GRID_BITS; a cell begins at step * (origin + index), index 0 .. 2^GRID_BITS - 1 with k low
    bits 0. In a keyframe quality k grows by its `coarser`, but not past GRID_BITS. Rows far away have wider steps.
    """

    origin: Annotated[list[Annotated[int, Range(-(1 << 52), 1 << 52)]], Length(3, 3)]  # steps
    step: Step  # world units
    finest: Annotated[int, Range(LEAST_CLASS, 200)]  # motion class whose cells are one step wide

    @property
    def unit(self) -> float:
        """World units that a cell of motion class 0 is wide: the scale of the scene, in which sizes are coded."""
        return self.step * 2.0**-self.finest


@dataclass(frozen=True, slots=True)
class KeyframeSteps:
    """Quantiser steps of the keyframe at factor 1."""

    quaternions: Step  # radians
    log_scales: Step  # ln
    opacity: Step  # of [0, 1]
    sh_dc: Step
    sh_rest: Step


@dataclass(frozen=True, slots=True)
class DeltaSteps:
    """Quantiser steps of the delta at factor 1."""

    means: Step  # motion units of the row
    quaternions: Step  # radians
    log_scales: Step  # ln
    opacity: Step  # of [0, 1]
    sh_dc: Step
    sh_rest: Step


def difference_steps(keyframe: KeyframeSteps, grid: Grid) -> DeltaSteps:
    return DeltaSteps(grid.unit, *(getattr(keyframe, name) for name in KEYFRAME_ATTRIBUTES))


@dataclass(frozen=True, slots=True)
class Atlas:
    """How one group's rows lie in the pictures of a keyframe quality or a level."""

    rows: Count
    centres: list[Annotated[int, Range(-MAX_CENTRE, MAX_CENTRE)]]  # a code for every channel
    planes: list[int]  # channels that have a plane, ascending; the others are constant at their centre
    plane_width: int  # samples, a multiple of 16
    columns: int  # planes side by side
    width: Side = 0  # of the pictures, samples; 0 where there are none
    height: Side = 0
    max_error: list[Annotated[float, Range(0, 1e38)]] = field(default_factory=list)  # for each attribute

    @property
    def plane_height(self) -> int:
        blocks = -(-self.rows // BLOCK**2)
        return BLOCK * -(-blocks // (self.plane_width // BLOCK))

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in samples of what the planes cover together."""
        return self.plane_width * self.columns, self.plane_height * -(-len(self.planes) // self.columns)

    @property
    def pages(self) -> int:
        """Return how many pictures show the atlas together, each the next `height` lines."""
        return -(-self.size[1] // self.height)


@dataclass(frozen=True, slots=True)
class GroupTier:
    """A keyframe tier of one group."""

    count: Count  # rows; a tier without rows has no files
    factor: Factor  # on the keyframe steps, and on top of it that of the keyframe quality
    sidecar: FileEntry  # shared by all its qualities
    qualities: list[Atlas]  # of no rows where nothing differs from the group `base`
    pictures: list[FileEntry]  # the picture in each quality; none of no rows


@dataclass(frozen=True, slots=True)
class SegmentLevel:
    """One level of one segment."""

    file: FileEntry  # none: nothing to fetch, the canonical space is shown
    frame_bytes: list[PictureBytes]  # H.264 bytes of each frame, the first with the slopes; empty without a file
    psnr: list[Decibels]  # for each keyframe quality; empty: not measured
    delta_e: list[Annotated[float, Range(0, MAX_DELTA_E)]]  # CIEDE2000 for each keyframe quality
    slopes: bool | None = None  # whether its file begins with slopes; None, and no such field: it does not


@dataclass(frozen=True, slots=True)
class Segment:
    """Frames [start, stop) of a group, fetched and decoded together."""

    start: FrameNumber
    stop: FrameNumber
    levels: list[SegmentLevel]


@dataclass(frozen=True, slots=True)
class LeftOut:
    """Something that was not written because pictures hardly need it, with the two numbers that decided."""

    what: str  # gaussians, updates, keyframe planes, delta planes, segments or sh bands
    count: int  # of what was left out
    error: float  # mean squared error of pictures that it makes, samples in 0..1
    bytes: float  # a frame that it saves, estimated


@dataclass(frozen=True, slots=True)
class Group:
    """Frames [start, stop) that share a canonical space: the table group/{n}.json.gz."""

    start: FrameNumber
    stop: FrameNumber
    count: Annotated[int, Range(1, MAX_COUNT)]  # rows written, over all tiers
    static: Count  # rows of `count` that no level carries
    unused: Count  # Gaussians no view uses: not written
    grid: Grid
    keyframe_steps: KeyframeSteps
    delta_steps: DeltaSteps
    colour_transform: str  # base64 of C x C little-endian int16, in 1 / TRANSFORM_UNITS; row k makes channel k
    tiers: list[GroupTier]
    levels: list[Atlas]  # of the deltas
    segments: Annotated[list[Segment], Length(1, MAX_FRAMES)]
    left_out: list[LeftOut]
    repairs: list[str]  # what was repaired in the input before coding
    base: Annotated[int, Range(1, MAX_FRAMES)] | None = None  # an earlier group, from 1, that keyframes differ from
    sound: FileEntry | None = None  # of its frames; None in a package without sound

    @property
    def difference_steps(self) -> DeltaSteps:
        return difference_steps(self.keyframe_steps, self.grid)


@dataclass(frozen=True, slots=True)
class Spans:
    """Parts of a sequence that follow each other, in columns: groups, or pages of one level."""

    frames: list[FrameCount]  # of each
    segments: list[FrameCount]  # of each
    bytes: list[Annotated[int, Range(1, MAX_FILE_BYTES)]]  # of its file
    sha256: Digests  # of their files, one after the other

    def __len__(self) -> int:
        return len(self.frames)

    def file(self, place: int) -> FileEntry:
        return FileEntry(self.bytes[place], self.sha256[DIGEST * place : DIGEST * (place + 1)])


@dataclass(frozen=True, slots=True)
class Entry:
    """What the index says of a group, or of the groups on a page."""

    start: int  # the first frame
    stop: int
    first_segment: int
    segments: int  # how many
    file: FileEntry  # the table of the group, or the page


@dataclass(frozen=True, slots=True)
class RungQuality:
    """The quality of a level with a keyframe quality over the whole package, as pictures have shown it."""

    psnr: Decibels  # of the mean squared error over pictures
    error: Annotated[float, Range(0, MAX_PSNR)]  # dB: standard error of the PSNR
    low: Decibels  # the 5 % quantile of the PSNR of pictures
    ssim: Annotated[float, Range(-1, 1)]  # mean
    delta_e: Annotated[float, Range(0, MAX_DELTA_E)]  # mean CIEDE2000
    pictures: Count


Rungs = list[list[RungQuality]]  # of each keyframe quality and level; empty: not measured


@dataclass(frozen=True, slots=True)
class Header:
    version: int
    generator: Generator
    attribution: str
    decisions: list[str]  # what the encoder chose for this scene and why, for people
    frame_rate: Annotated[list[Ticks], Length(2, 2)]  # numerator, denominator: frames a second
    timescale: Ticks  # a second in the MP4 files and the MPD
    frames: FrameCount  # so far, where more are to come
    live: bool  # whether more groups are to come
    sh_degree: Annotated[int, Range(0, 3)]
    keyframe_gain: Gain  # luma levels a step in keyframe atlases
    delta_gain: Gain  # luma levels a step in delta atlases
    region: Region
    world: World | None  # None, and no such field in airgs.json: the way up is unknown
    origin: Point | None  # where positions are from in the world; None, and no such field in airgs.json: from zero
    poster: FileEntry | None  # None, and no such field in airgs.json: no poster
    views: Views
    qualities: Annotated[list[KeyframeQuality], Choices]
    levels: Annotated[list[Level], Choices]
    tiers: Annotated[int, Range(1, MAX_CHOICES)]  # keyframe tiers
    rungs: Rungs
    sound: Sound | None  # None, and no such field in airgs.json: no sound
    init: FileEntry  # init.mp4, for DASH players alone

    @property
    def fps(self) -> Fraction:
        return Fraction(*self.frame_rate)

    @property
    def frame_ticks(self) -> int:
        return self.timescale * self.frame_rate[1] // self.frame_rate[0]

    def packets(self, start: int, stop: int) -> range:
        """Return the packets of sound, counted from the beginning, that start in the time of frames [start, stop)."""
        first, last = (-(-frame * PACKETS * self.frame_rate[1] // self.frame_rate[0]) for frame in (start, stop))
        return range(first, last)

    @property
    def colour_channels(self) -> int:
        """Colour channels C of an atlas: three of DC, then SH rest."""
        return 3 * (1 + SH_REST[self.sh_degree])

    @property
    def measured(self) -> bool:
        return self.views.reference != "none"

    def level_index(self, choice: str | int) -> int:
        """Return the index of a level given by its id ("L1") or its index (1 or "1"). Raises ConfigError."""
        return _index_of("level", choice, [level.id for level in self.levels])

    def quality_index(self, choice: str | int) -> int:
        """Return the index of a keyframe quality given by its id ("Q1") or its index (1 or "1"). Raises ConfigError."""
        return _index_of("keyframe_quality", choice, [quality.id for quality in self.qualities])


@dataclass(frozen=True, slots=True)
class Root(Header):
    """airgs.json."""

    index: Annotated[list[Spans], Length(1, MAX_LEVELS)]  # groups, then pages of each level: what fills no page above


def _index_of(what: str, choice: str | int, ids: list[str]) -> int:
    names = [*ids, *map(str, range(len(ids)))]
    if str(choice) in names:
        return names.index(str(choice)) % len(ids)
    raise ConfigError(f"{what}: expected one of {', '.join(ids)}, got {choice!r}")


def digest(data: bytes | bytearray) -> str:
    """Return the first 24 bytes of the SHA-256 of a file as 32 characters of base64url (RFC 4648, section 5)."""
    return shorten(hashlib.sha256(data).digest())


def shorten(sha256: bytes) -> str:
    return base64.urlsafe_b64encode(sha256[:24]).decode("ascii")


def file_entry(data: bytes) -> FileEntry:
    return FileEntry(len(data), digest(data))
