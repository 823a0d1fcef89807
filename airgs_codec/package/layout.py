"""How a package is laid out: its files by their paths, and the channels of its keyframe and delta atlases.

FORMAT.md, sections 2 and 5. Numbers in paths, and levels of the index, count from 1; that of a media file may be the
placeholder of a template. This is the one place that knows the order of channels: those of an attribute follow each
other, and colour comes last, since only its width, C channels, depends on the scene.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from enum import StrEnum
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from airgs_codec.package.tables import DeltaSteps, Group, KeyframeSteps

JSON_NAME = "airgs.json"
MPD_NAME = "manifest.mpd"
INIT_NAME = "init.mp4"
POSTER_NAME = "poster.jpg"
SOUND_INIT_NAME = "sound/init.m4a"
ROOTS = (JSON_NAME, MPD_NAME)  # what changes while a package grows; all other files are written once
MEDIA_TYPES = {  # by how the name of a file ends
    ".bin": "application/octet-stream",
    ".jpg": "image/jpeg",
    ".json": "application/json",
    ".json.gz": "application/gzip",
    ".m4a": "audio/mp4",
    ".m4s": "video/mp4",
    ".mp4": "video/mp4",
    ".mpd": "application/dash+xml",
}

_ORDINAL, _NUMBER = r"(0|[1-9]\d?)", r"([1-9]\d{0,6})"
PATTERNS = {  # how a path is built -> what `locate` calls it
    rf"keyframe/T{_ORDINAL}/{_NUMBER}\.bin": "sidecar",
    rf"keyframe/T{_ORDINAL}/Q{_ORDINAL}/{_NUMBER}\.m4s": "keyframe",
    rf"delta/L{_ORDINAL}/{_NUMBER}\.m4s": "delta",
    rf"sound/{_NUMBER}\.m4a": "sound",
    rf"group/{_NUMBER}\.json\.gz": "group",
    rf"index/([1-9])/{_NUMBER}\.json": "page",
}


class FileKind(StrEnum):
    """What a file of a package carries; the values are the names in reports."""

    KEYFRAME = "keyframe"  # the picture of a keyframe tier with its detail
    DELTA = "delta"  # the pictures of a delta segment with its escapes
    SIDECARS = "sidecars"  # positions
    SOUND = "sound"
    INIT = "init"  # for DASH players alone
    POSTER = "poster"  # what is seen until the first picture is there
    MANIFESTS = "manifests"  # airgs.json, the MPD, pages of the index and tables of groups


_FIXED = dict.fromkeys(ROOTS, FileKind.MANIFESTS) | {POSTER_NAME: FileKind.POSTER}
_FIXED |= dict.fromkeys((INIT_NAME, SOUND_INIT_NAME), FileKind.INIT)
_LOCATED = {"sidecar": FileKind.SIDECARS} | {kind: FileKind(kind) for kind in ("keyframe", "delta", "sound")}


@lru_cache(1 << 14)  # more paths than a session looks at again and again
def locate(path: str) -> tuple[str, tuple[int, ...]]:
    """Return what a path names, as in `PATTERNS`, and the numbers in it; "" for any other path."""
    for pattern, what in PATTERNS.items():
        if match := re.fullmatch(pattern, path, re.ASCII):
            return what, tuple(map(int, match.groups()))
    return "", ()


def file_kind(path: str) -> FileKind:
    return _FIXED.get(path) or _LOCATED.get(locate(path)[0], FileKind.MANIFESTS)


def belongs(path: str) -> bool:
    return path in _FIXED or locate(path)[0] != ""


def keyframe_sidecar_path(tier: int, number: int) -> str:
    return f"keyframe/T{tier}/{number}.bin"


def keyframe_media_path(tier: int, quality: int, number: int | str) -> str:
    return f"keyframe/T{tier}/Q{quality}/{number}.m4s"


def delta_media_path(level: int, number: int | str) -> str:
    return f"delta/L{level}/{number}.m4s"


def sound_path(number: int | str) -> str:
    return f"sound/{number}.m4a"


def group_path(number: int) -> str:
    return f"group/{number}.json.gz"


def page_path(level: int, number: int) -> str:
    return f"index/{level}/{number}.json"


COLOUR = "colour"


@dataclass(frozen=True, slots=True)
class Layout:
    """The channels of a kind of atlas, in order: those of `runs`, then C of colour."""

    kind: str  # "keyframe" or "delta"
    runs: tuple[tuple[str, int], ...]  # attributes, with steps of these names, and their channels

    @property
    def attributes(self) -> tuple[str, ...]:
        """Attributes in channel order, colour last: the order of `Atlas.max_error`."""
        return (*(name for name, _ in self.runs), COLOUR)

    def names(self, colours: int) -> list[str]:
        return [name for name, channels in self.runs for _ in range(channels)] + [COLOUR] * colours

    def width(self, colours: int) -> int:
        return len(self.names(colours))

    def slice(self, attribute: str) -> slice:
        """Return where the channels of an attribute are. Raises ValueError for one that this kind does not have."""
        start = self.names(1).index(attribute)
        return slice(start, None if attribute == COLOUR else start + dict(self.runs)[attribute])

    def attribute_index(self, channels: int) -> NDArray[np.intp]:
        """Return (channels,) the place of each channel's attribute in `attributes`."""
        return np.array([self.attributes.index(name) for name in self.names(channels)[:channels]])

    def steps(self, steps: KeyframeSteps | DeltaSteps, colours: int) -> NDArray[np.float64]:
        """Return (channels,) quantiser steps at factor 1; colour channels count in steps already."""
        return np.array([1.0 if name == COLOUR else getattr(steps, name) for name in self.names(colours)])


# Motion units, ln(world units), radians, and opacity of [0, 1].
_RUNS = (("means", 3), ("log_scales", 3), ("quaternions", 3), ("opacity", 1))
KEYFRAME, DELTA = Layout("keyframe", _RUNS[1:]), Layout("delta", _RUNS)  # canonical means travel in the sidecar


def keyframe_layout(group: Group) -> Layout:
    """Return the layout of the keyframe pictures of a group: that of a delta where they are differences to a base."""
    return KEYFRAME if group.base is None else DELTA
