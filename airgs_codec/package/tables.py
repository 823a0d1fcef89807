"""airgs.json: the normative tables of a package as frozen values, their paths and their JSON.

T tiers, Q key qualities, L levels, C colour channels. FORMAT.md says what each field means. What a field may hold
beside its type stands in its annotation (`constraints`); `schema` makes the JSON Schema of it, and
`parse.parse_manifest` reads the JSON back and refuses everything else.
"""

from __future__ import annotations

import base64
import dataclasses
import hashlib
import json
from dataclasses import dataclass
from enum import StrEnum
from fractions import Fraction
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from airgs_codec.errors import ConfigError, FormatError
from airgs_codec.media.metrics import psnr
from airgs_codec.package.constraints import Length, OneOf, Pattern, Range
from airgs_codec.scene.gaussians import SH_REST

VERSION = 1
JSON_NAME = "airgs.json"
MPD_NAME = "manifest.mpd"
INIT_NAME = "init.mp4"

MAX_COUNT = 1 << 24  # Gaussians a group
MAX_FRAMES = 1_000_000
MAX_SIDE = 16384  # samples, either side of a picture
MAX_FILE_BYTES = 1 << 31
MAX_CHOICES = 64  # tiers, qualities, levels
MAX_PLACES = 64
MAX_BITS = 21  # of a grid index
MAX_CENTRE = 1 << 30  # so that a centre, a luma level and the base of an escape add up within int32
MAX_PSNR = 1000.0  # dB; nothing measured comes near, and ten to the power of a tenth of it is still a float
MAX_DELTA_E = 1000.0  # CIEDE2000; the largest of two sRGB colours is about 120
BLOCK = 16  # samples, either side of the blocks that a plane is made of
STATE_ATTRIBUTES = ("means", "quaternions", "log_scales", "opacity", "sh_dc", "sh_rest")
KEY_ATTRIBUTES = STATE_ATTRIBUTES[1:]  # canonical means travel in the sidecar
STATIC = 255  # depth of a row that no level carries

Path = Annotated[
    str,
    Pattern(
        r"key/T\d+/\d+\.bin|(key/T\d+/Q|state/L)\d+/(init\.mp4|\d+\.(m4s|bin))",
        "a path of this format",
        "unsafe_path",
    ),
]
Digest = Annotated[str, Pattern("[A-Za-z0-9_-]{42}[AEIMQUYcgkosw048]", "SHA-256 as 43 characters of base64url")]
Count = Annotated[int, Range(0, MAX_COUNT)]
FrameNumber = Annotated[int, Range(0, MAX_FRAMES)]
FileNumber = Annotated[int, Range(0, MAX_FRAMES)]
FileBytes = Annotated[int, Range(1, MAX_FILE_BYTES)]
Side = Annotated[int, Range(0, MAX_SIDE)]
Ticks = Annotated[int, Range(1, 1 << 31)]
Share = Annotated[float, Range(0, 1)]
Factor = Annotated[float, Range(1e-6, 1e6)]
Step = Annotated[float, Range(1e-30, 1e30)]
Gain = Annotated[float, Range(1e-3, 128)]
Decibels = Annotated[float, Range(-MAX_PSNR, MAX_PSNR)]
Point = Annotated[list[Annotated[float, Range(-1e30, 1e30)]], Length(3, 3)]
Choices = Length(1, MAX_CHOICES)


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


@dataclass(frozen=True, slots=True)
class Views:
    """How many pictures were looked at."""

    decided: Count  # of each group, to decide what matters
    measured: Count  # of each segment, to measure quality: other views than those
    reference: Annotated[str, OneOf(("original", "none"))]  # the unpruned input; none: quality was not measured


@dataclass(frozen=True, slots=True)
class KeyQuality:
    """A quality of the key: steps multiplied by `factor`, the sides of the cells of canonical means by 2^coarser."""

    id: str
    factor: Factor
    coarser: Annotated[int, Range(0, MAX_BITS)]  # ascending; 0 for the first


@dataclass(frozen=True, slots=True)
class Level:
    """A pruning level: which share of the moving rows is withheld at least, and the step factor of the others."""

    id: str
    pruned: Share  # of the moving rows
    factor: Factor
    tiers: int  # key tiers that its viewers fetch; rows of later tiers have no state in it
    quality: Annotated[int, Range(0, MAX_CHOICES - 1)]  # key quality that its states correct: its rung of the ladder


@dataclass(frozen=True, slots=True)
class Picture:
    """The coded picture of a representation, the same in every segment; 0x0 when it has none."""

    width: Side
    height: Side
    codecs: str  # RFC 6381, such as avc1.64000D


@dataclass(frozen=True, slots=True)
class Grid:
    """Nested cubic cells of canonical means: a row of motion class c lies in the middle of a cell of step 2^k.

    k = c - finest, from 0 to `bits`; a cell begins at origin + step * index, index 0 .. 2^bits - 1 with k low bits 0.
    In a key quality k grows by its `coarser`, but not past `bits`.
    """

    origin: Annotated[list[float], Length(3, 3)]  # world units
    step: Annotated[float, Range(0, 1e30)]  # world units
    bits: Annotated[int, Range(1, MAX_BITS)]
    finest: Annotated[int, Range(-128, 127 + MAX_BITS)]  # motion class whose cells are one step wide


@dataclass(frozen=True, slots=True)
class KeySteps:
    """Quantiser steps of the key at factor 1."""

    quaternions: Step  # radians
    log_scales: Step  # ln
    opacity: Step  # of [0, 1]
    sh_dc: Step
    sh_rest: Step


@dataclass(frozen=True, slots=True)
class StateSteps:
    """Quantiser steps of the state at factor 1."""

    means: Step  # motion units of the row
    quaternions: Step  # radians
    log_scales: Step  # ln
    opacity: Step  # of [0, 1]
    sh_dc: Step
    sh_rest: Step


@dataclass(frozen=True, slots=True)
class Atlas:
    """How one group's rows lie in the pictures of a representation."""

    rows: Count
    centres: list[Annotated[int, Range(-MAX_CENTRE, MAX_CENTRE)]]  # a code for every channel
    planes: list[int]  # channels that have a plane, ascending; the others are constant at their centre
    plane_width: int  # samples, a multiple of 16
    columns: int  # planes side by side
    max_error: list[Annotated[float, Range(0, 1e38)]] = dataclasses.field(default_factory=list)  # for each attribute

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in samples of what the planes cover together."""
        height = plane_height(self.rows, self.plane_width) * -(-len(self.planes) // self.columns)
        return self.plane_width * self.columns, height


def plane_height(rows: int, plane_width: int) -> int:
    """Samples from the top to the bottom of a plane of `rows` rows."""
    blocks = -(-rows // BLOCK**2)
    return BLOCK * -(-blocks // (plane_width // BLOCK))


@dataclass(frozen=True, slots=True)
class GroupTier:
    """One key tier of one group."""

    count: Count  # rows
    number: FileNumber  # of its files; 0: no rows, no files
    qualities: list[Atlas]


@dataclass(frozen=True, slots=True)
class Group:
    """Frames [start, stop) that share a canonical space."""

    start: FrameNumber
    stop: FrameNumber
    count: Annotated[int, Range(1, MAX_COUNT)]  # rows written, over all tiers
    static: Count  # rows of `count` that no level carries
    unused: Count  # Gaussians no view uses: not written
    grid: Grid
    key_steps: KeySteps
    state_steps: StateSteps
    colour_transform: str  # base64 of C x C little-endian int16, in 1/32767; row k makes channel k
    tiers: list[GroupTier]
    levels: list[Atlas]


@dataclass(frozen=True, slots=True)
class SegmentLevel:
    """One level of one segment."""

    number: FileNumber  # of its files; 0: nothing to fetch, the canonical space is shown
    frame_bytes: list[FileBytes]  # H.264 bytes of each frame, in display order
    psnr: list[Decibels]  # for each key quality; empty: not measured
    worst: list[Decibels]  # PSNR of the worst picture, for each key quality
    ssim: list[Annotated[float, Range(-1, 1)]]  # for each key quality
    delta_e: list[Annotated[float, Range(0, MAX_DELTA_E)]]  # CIEDE2000 for each key quality


@dataclass(frozen=True, slots=True)
class Segment:
    """Frames [start, stop) of group `group`, fetched and decoded together."""

    group: FrameNumber
    start: FrameNumber
    stop: FrameNumber
    levels: list[SegmentLevel]


@dataclass(frozen=True, slots=True)
class FileEntry:
    """Length and digest of a file of the package."""

    bytes: FileBytes
    sha256: Digest


@dataclass(frozen=True, slots=True)
class LeftOut:
    """Something that was not written because pictures hardly need it, with the two numbers that decided."""

    what: str  # gaussians, updates, key planes, state planes, segments or sh bands
    group: int
    count: int  # of what was left out
    error: float  # mean squared error of pictures that it makes, samples in 0..1
    bytes: float  # a frame that it saves, estimated


@dataclass(frozen=True, slots=True)
class Manifest:
    """Everything a decoder needs that is not pixels."""

    version: int
    generator: Generator
    attribution: str
    repairs: list[str]  # what was repaired in the input before coding
    decisions: list[str]  # what the encoder chose for this scene and why, for people
    frame_rate: Annotated[list[Ticks], Length(2, 2)]  # numerator, denominator: frames a second
    timescale: Ticks  # a second in the MP4 files and the MPD
    frames: Annotated[int, Range(1, MAX_FRAMES)]
    sh_degree: Annotated[int, Range(0, 3)]
    key_gain: Gain  # luma levels a step in key atlases
    state_gain: Gain  # luma levels a step in state atlases
    region: Region
    views: Views
    qualities: Annotated[list[KeyQuality], Choices]
    levels: Annotated[list[Level], Choices]
    key_pictures: Annotated[list[list[Picture]], Choices]  # T x Q
    state_pictures: list[Picture]  # L
    groups: list[Group]
    segments: list[Segment]
    left_out: list[LeftOut]
    files: dict[Path, FileEntry]

    @property
    def fps(self) -> Fraction:
        """Frames a second, exact."""
        return Fraction(*self.frame_rate)

    @property
    def frame_ticks(self) -> int:
        """Duration of a frame in ticks of `timescale`."""
        return self.timescale * self.frame_rate[1] // self.frame_rate[0]

    @property
    def colour_channels(self) -> int:
        """Colour channels C of an atlas: three DC, then SH rest."""
        return 3 * (1 + SH_REST[self.sh_degree])

    @property
    def tier_count(self) -> int:
        """How many key tiers there are, T."""
        return len(self.key_pictures)

    def level_index(self, choice: str | int) -> int:
        """Index of a level given by its id ("L1") or its index (1 or "1"). Raises ConfigError for any other."""
        return _index_of("level", choice, [level.id for level in self.levels])

    def quality_index(self, choice: str | int) -> int:
        """Index of a key quality given by its id ("Q1") or its index (1 or "1"). Raises ConfigError for any other."""
        return _index_of("key quality", choice, [quality.id for quality in self.qualities])

    def key_files(self, group: int, tier: int, quality: int) -> list[str]:
        """Sidecar, picture and detail of one key unit; empty when the tier has no rows in that group."""
        number = self.groups[group].tiers[tier].number
        paths = (
            key_sidecar_path(tier, number),
            key_media_path(tier, quality, number),
            key_detail_path(tier, quality, number),
        )
        return list(paths) if number else []

    def state_files(self, segment: int, level: int) -> list[str]:
        """Files of one state segment without its init segment; empty when there is nothing to fetch."""
        number = self.segments[segment].levels[level].number
        return [state_media_path(level, number), state_sidecar_path(level, number)] if number else []

    def init_files(self, quality: int, level: int) -> list[str]:
        """Init segments of everything a viewer of one rung decodes."""
        rows = self.key_pictures[: self.levels[level].tiers]
        keys = [key_init_path(t, quality) for t, row in enumerate(rows) if row[quality].width]
        return keys + ([state_init_path(level)] if self.state_pictures[level].width else [])

    def bytes_of(self, paths: list[str]) -> int:
        """Total length of files."""
        return sum(self.files[path].bytes for path in paths)

    def rung_files(self, quality: int, level: int) -> list[str]:
        """Every file a viewer of one rung fetches from start to end, without the two manifests."""
        paths = self.init_files(quality, level)
        for group in range(len(self.groups)):
            for tier in range(self.levels[level].tiers):
                paths += self.key_files(group, tier, quality)
        for segment in range(len(self.segments)):
            paths += self.state_files(segment, level)
        return paths

    def segment_at(self, frame: int) -> int:
        """Index of the segment that shows `frame`. Raises IndexError outside the sequence."""
        for index, segment in enumerate(self.segments):
            if segment.start <= frame < segment.stop:
                return index
        raise IndexError(f"frame {frame}: the sequence has frames 0..{self.frames - 1}")

    def to_json(self) -> str:
        """The text of airgs.json; `parse_manifest` gives the same value back."""
        return json.dumps(dataclasses.asdict(self), separators=(",", ":"), allow_nan=False)


def _index_of(what: str, choice: str | int, ids: list[str]) -> int:
    for index, name in enumerate(ids):
        if str(choice) in (name, str(index)):
            return index
    raise ConfigError(f"{what}: expected one of {', '.join(ids)}, got {choice!r}")


class FileKind(StrEnum):
    """What a file of a package carries; the values are the names in reports."""

    MANIFESTS = "manifests"
    INIT = "init"
    KEY = "key"  # pictures of a key unit
    STATE = "state"  # pictures of a state segment
    SIDECARS = "sidecars"  # positions and escapes


def file_kind(path: str) -> FileKind:
    """What a file carries, by its place in the package: the inverse of the functions below."""
    folder, _, name = path.rpartition("/")
    if not folder:
        return FileKind.MANIFESTS
    if name == INIT_NAME:
        return FileKind.INIT
    return FileKind.SIDECARS if name.endswith(".bin") else FileKind(folder.split("/")[0])


def key_init_path(tier: int, quality: int) -> str:
    """Init segment of a key representation."""
    return f"key/T{tier}/Q{quality}/{INIT_NAME}"


def key_media_path(tier: int, quality: int, number: int | str) -> str:
    """Picture of a key unit; `number` may be the placeholder of a template."""
    return f"key/T{tier}/Q{quality}/{number}.m4s"


def key_sidecar_path(tier: int, number: int) -> str:
    """Sidecar of a key unit, the same for all its qualities."""
    return f"key/T{tier}/{number}.bin"


def key_detail_path(tier: int, quality: int, number: int) -> str:
    """What a key unit adds in one quality beside its picture: the detail of positions, and escapes."""
    return f"key/T{tier}/Q{quality}/{number}.bin"


def state_init_path(level: int) -> str:
    """Init segment of a state representation."""
    return f"state/L{level}/{INIT_NAME}"


def state_media_path(level: int, number: int | str) -> str:
    """Pictures of a state segment; `number` may be the placeholder of a template."""
    return f"state/L{level}/{number}.m4s"


def state_sidecar_path(level: int, number: int) -> str:
    """Escapes of a state segment."""
    return f"state/L{level}/{number}.bin"


def digest(data: bytes | bytearray) -> Digest:
    """SHA-256 of a file as 43 characters of base64url (RFC 4648, section 5) without the padding."""
    return base64.urlsafe_b64encode(hashlib.sha256(data).digest()).decode("ascii").rstrip("=")


def pack_matrix(matrix: NDArray[np.float64]) -> str:
    """Entries in -1..1 as base64 of little-endian int16 in 1/32767, row by row."""
    return base64.b64encode(np.rint(matrix * 32767).astype("<i2").tobytes()).decode("ascii")


def unpack_matrix(text: str, side: int) -> NDArray[np.float64]:
    """Inverse of `pack_matrix`: (side, side). Raises FormatError(bad_value)."""
    try:
        raw = base64.b64decode(text, validate=True)
        return np.frombuffer(raw, "<i2").reshape(side, side) / 32767.0
    except ValueError as error:
        raise FormatError(
            "bad_value", f"{JSON_NAME} colour_transform", f"expected {side}x{side} int16: {error}"
        ) from error


def expected_files(m: Manifest) -> list[str]:
    """Every file the tables refer to, each once, in the order of the package's folders."""
    paths: dict[str, None] = {}
    for quality in range(len(m.qualities)):
        for level in range(len(m.levels)):
            paths.update(dict.fromkeys(m.rung_files(quality, level)))
    return sorted(paths)


@dataclass(frozen=True, slots=True)
class Quality:
    """How near the pictures of a rung are to those of the original, over the whole sequence."""

    psnr: float  # dB, of the mean squared error over pictures
    worst: float  # dB, of the picture with the largest error
    ssim: float  # mean over pictures
    delta_e: float  # CIEDE2000, mean over pictures


def pooled_quality(m: Manifest, level: int, quality: int) -> Quality | None:
    """Quality of a rung, segments weighed by their frames; None when one of them was not measured."""
    squared, similarity, difference, worst = 0.0, 0.0, 0.0, MAX_PSNR
    for segment in m.segments:
        measured = segment.levels[level]
        if not measured.psnr:
            return None
        weight = (segment.stop - segment.start) / m.frames
        squared += weight * 10.0 ** min(-measured.psnr[quality] / 10, 300.0)  # 300: a float, whatever a table claims
        worst = min(worst, measured.worst[quality])
        similarity += weight * measured.ssim[quality]
        difference += weight * measured.delta_e[quality]
    return Quality(psnr(squared), worst, similarity, difference)
