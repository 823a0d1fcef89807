"""The files of a package by their paths: FORMAT.md, section 2. Numbers in paths count from 1."""

from __future__ import annotations

import re
from enum import StrEnum

JSON_NAME = "airgs.json"
MPD_NAME = "manifest.mpd"
INIT_NAME = "init.mp4"
ROOTS = (JSON_NAME, MPD_NAME)  # what changes while a package grows; all other files are written once
MEDIA_TYPES = {  # by how the name of a file ends
    ".bin": "application/octet-stream",
    ".json": "application/json",
    ".json.gz": "application/gzip",
    ".m4s": "video/mp4",
    ".mp4": "video/mp4",
    ".mpd": "application/dash+xml",
}

_ORDINAL, _NUMBER = r"(0|[1-9]\d?)", r"([1-9]\d{0,6})"
_TILE = r"(?:P([1-9]\d?)/)?"
PATTERNS = {  # how a path is built -> what `locate` calls it
    rf"key/{_TILE}T{_ORDINAL}/{_NUMBER}\.bin": "sidecar",
    rf"key/{_TILE}T{_ORDINAL}/Q{_ORDINAL}/{_NUMBER}\.m4s": "key",
    rf"state/{_TILE}L{_ORDINAL}/{_NUMBER}\.m4s": "state",
    rf"group/{_NUMBER}\.json\.gz": "group",
    rf"index/([1-9])/{_NUMBER}\.json": "page",
}


class FileKind(StrEnum):
    """What a file of a package carries; the values are the names in reports."""

    MANIFESTS = "manifests"  # airgs.json, the MPD, pages of the index and tables of groups
    INIT = "init"  # for DASH players alone
    KEY = "key"  # the picture of a key unit with its detail
    STATE = "state"  # the pictures of a state segment with its escapes
    SIDECARS = "sidecars"  # positions


def file_kind(path: str) -> FileKind:
    """What a file carries, by its place in the package."""
    if path == INIT_NAME:
        return FileKind.INIT
    folder = path.split("/")[0]
    if folder not in ("key", "state"):
        return FileKind.MANIFESTS
    return FileKind.SIDECARS if path.endswith(".bin") else FileKind(folder)


def locate(path: str) -> tuple[str, list[int]]:
    """What a path names, sidecar, key, state, group or page, and the numbers in it; "" for any other path.

    The first number of sidecars, keys and states is that of the tile, 0 in a package that has one.
    """
    for pattern, what in PATTERNS.items():
        if match := re.fullmatch(pattern, path, re.ASCII):
            return what, [int(number or 0) for number in match.groups()]
    return "", []


def belongs(path: str) -> bool:
    """Whether a file of a package can have this path."""
    return path in (JSON_NAME, MPD_NAME, INIT_NAME) or locate(path)[0] != ""


def tile_folder(tile: int, tiles: int) -> str:
    """The folder in paths of a tile, counted from 0, with a slash; the only tile of a package has none."""
    return f"P{tile + 1}/" if tiles > 1 else ""


def key_sidecar_path(folder: str, tier: int, number: int) -> str:
    """Sidecar of a key unit, the same for all its qualities; `folder` is that of its tile."""
    return f"key/{folder}T{tier}/{number}.bin"


def key_media_path(folder: str, tier: int, quality: int, number: int | str) -> str:
    """Picture of a key unit with its detail; `number` may be the placeholder of a template."""
    return f"key/{folder}T{tier}/Q{quality}/{number}.m4s"


def state_media_path(folder: str, level: int, number: int | str) -> str:
    """Pictures of a state segment of a tile with its escapes; `number` may be the placeholder of a template."""
    return f"state/{folder}L{level}/{number}.m4s"


def group_path(number: int) -> str:
    """Table of a group."""
    return f"group/{number}.json.gz"


def page_path(level: int, number: int) -> str:
    """Page of the index; the level counts from 1 as well."""
    return f"index/{level}/{number}.json"
