"""Whole packages of the repository: which files hold what, what is in them, and the frames that they show.

Codes are those of the decoder, which tests/golden pins; what they mean is computed by the formulas.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

from airgs_codec.coding.atlas import line_times
from airgs_codec.coding.grid import grid_means
from airgs_codec.media.h264 import open_segment
from tests.faces import Package, decode_key, decode_pictures, open_package
from tests.makers.vectors.formulas import Coding, Row, key_row, listed, state_row, unpack_transform
from tests.makers.vectors.tables import PAGE, Tables, pages_to
from tests.makers.vectors.text import Table, binary
from tests.support.digests import decode_slopes
from tests.support.paths import GOLDEN, REPOSITORY, VALID

ATTRIBUTES = ("means", "quaternions", "log_scales", "alpha", "colours")
FOX, FINE, ROOM, LINED = GOLDEN / "fox", GOLDEN / "fox-fine", GOLDEN / "room", VALID / "lined"
INDEXED = (FOX, VALID / "paged", VALID / "live", VALID / "two-groups-sh1", VALID / "kept", ROOM)
SHOWN: dict[Path, list[tuple[int, int, int, int]]] = {  # frame, key quality, level, key tiers
    FOX: [*((frame, q, j, 2) for frame in (0, 3) for q in (0, 1) for j in (0, 1)), (3, 0, 0, 1), (1, 1, 1, 1)],
    FINE: [(1, 0, 0, 2)],
    ROOM: [(0, 0, 0, 2), (2, 0, 0, 2), (3, 1, 1, 2), (3, 0, 0, 1)],
    LINED: [(1, 0, 0, 2), (5, 1, 1, 2)],
}
INDEX = (65, 4095, 4096, 4097, 86_400)  # groups of packages that are no more than their index
EVERY = 16  # rows of which one is in the vectors
STATIC = 255


def tables() -> tuple[Table, bytes]:
    frames: list[dict[str, Any]] = []
    data = b""
    for folder, views in SHOWN.items():
        for view in views:
            case, numbers = _frame(folder, *view)
            frames.append({**case, "offset": len(data)})
            data += numbers
    named = [(_name(folder), Tables(folder)) for folder in INDEXED]
    return {
        "groups": [{"package": name, **_group(t, g)} for name, t in named for g in _some(len(t.groups))],
        "index": [_place(count, group) for count in INDEX for group in sorted({0, count // 2, count - 65, count - 1})],
        "startup": [{"package": name, **start} for name, t in named for start in _startups(t)],
        "units": [_unit(of, p.relative_to(of).as_posix()) for of in (FOX, VALID / "kept") for p in _media(of)],
        "frames": frames,
    }, data


def _media(folder: Path) -> list[Path]:
    return sorted(folder.rglob("*.m4s"))


def _name(folder: Path) -> str:
    return folder.relative_to(REPOSITORY).as_posix()


def _some(count: int) -> list[int]:
    """Of few all; else the first, and those about the end of a page."""
    return list(range(count)) if count < 5 else [0, 63, 64]


def _group(t: Tables, group: int) -> dict[str, Any]:
    table, tiers = t.groups[group], range(t.root["tiers"])
    qualities, levels = range(len(t.root["qualities"])), range(len(t.root["levels"]))
    segments = [
        {"start": s["start"], "stop": s["stop"], "files": [t.state(group, number, j) for j in levels]}
        for number, s in enumerate(table["segments"])
    ]
    return {
        "number": group + 1,
        "start": table["start"],
        "stop": table["stop"],
        "pages": t.pages_to(group),
        "table": list(t.group_paths())[group],
        "sidecars": [t.sidecar(group, k) for k in tiers],
        "pictures": [[t.picture(group, k, q) for q in qualities] for k in tiers],
        "segments": segments,
    }


def _place(count: int, group: int) -> dict[str, Any]:
    """Where a group is, counted from 0, in an index of so many, of which each has one frame."""
    entries = [count // PAGE**level % PAGE for level in range(9)]
    while not entries[-1]:
        entries.pop()
    return {"count": count, "entries": entries, "frame": group, "number": group + 1, "pages": pages_to(group, count)}


def _startups(t: Tables) -> list[dict[str, Any]]:
    """The first frame of the package and the last, at the best rung and at the least."""
    worst = len(t.root["qualities"]) - 1, len(t.root["levels"]) - 1
    out = []
    for frame in sorted({0, t.root["frames"] - 1}):
        for quality, level in sorted({(0, 0), worst}):
            for tiers in sorted({1, t.root["levels"][level]["tiers"]}):
                files = t.first_files(frame, quality, level, tiers)
                out.append({"frame": frame, "quality": quality, "level": level, "tiers": tiers, "files": files})
    return out


def _unit(folder: Path, path: str) -> dict[str, Any]:
    columns, shown = open_segment((folder / path).read_bytes(), path)
    pictures = list(shown)
    return {
        "package": _name(folder),
        "path": path,
        "columns": None if columns is None else binary(columns),
        "width": pictures[0].shape[1],
        "height": pictures[0].shape[0],
        "luma": [sha256(picture.tobytes()).hexdigest() for picture in pictures],
    }


def _frame(folder: Path, frame: int, quality: int, level: int, tiers: int) -> tuple[dict[str, Any], bytes]:
    rows = _rows(folder, frame, quality, level, tiers)
    expected: dict[str, Any] = listed(list(rows.values()), limit=True)
    data = b"".join(_float32(expected["values"][name]) for name in ATTRIBUTES)
    tolerance = {name: max(expected["tolerance"][name]) for name in ATTRIBUTES}
    view = {"frame": frame, "quality": quality, "level": level, "tiers": tiers}
    return {"package": _name(folder), **view, "rows": list(rows), "tolerance": tolerance}, data


def _rows(folder: Path, frame: int, quality: int, level: int, tiers: int) -> dict[int, Row]:
    """The rows that the vectors have, by number, as they are shown."""
    t, package = Tables(folder), open_package(folder)
    group, root = t.group_at(frame), t.root
    table = t.groups[group]
    transform = unpack_transform(table["colour_transform"])
    keys = [row for k in range(tiers) if t.sidecar(group, k) for row in _key_rows(t, package, (group, k, quality))]
    shown = {number: row for number, (row, _, _) in enumerate(keys) if number % EVERY == 0}
    segment = t.segment_at(frame)
    if not t.state(group, segment, level):
        return shown
    place = frame - table["segments"][segment]["start"]
    number = t.segments_before(group) + segment
    codes = next(decode_pictures(package, number, level, range(place, place + 1))).codes().astype(np.float64)
    slopes = decode_slopes(package, number, level)
    if slopes is not None:
        length = table["segments"][segment]["stop"] - table["segments"][segment]["start"]
        codes += line_times(length)[place] * slopes
    changes = codes.T.tolist()
    state = Coding(table["state_steps"], root["levels"][level]["factor"], root["state_gain"], transform)
    carried = [row for row, (_, _, depth) in enumerate(keys) if level <= depth < STATIC]
    for row, numbers in zip(carried, changes, strict=False):  # of fewer tiers, the first rows
        if row in shown:
            shown[row] = state_row(shown[row], numbers, state, keys[row][1])
    return shown


def _key_rows(t: Tables, package: Package, of: tuple[int, int, int]) -> list[tuple[Row, int, int]]:
    """The canonical value, the motion class and the depth of every row of a (group, tier, quality)."""
    group, tier, quality = of
    codes, sidecar = decode_key(package, group, tier, quality)
    named, depths, base = t.root["qualities"][quality], sidecar.depths.tolist(), t.base_of(group)
    grid = package.manifest.groups[group].grid
    table = t.groups[group]
    transform = unpack_transform(table["colour_transform"])
    factor = named["factor"] * table["tiers"][tier]["factor"]
    if base is not None:
        steps = table["key_steps"] | {"means": table["grid"]["step"] * 2.0 ** -table["grid"]["finest"]}
        change = Coding(steps, factor, t.root["key_gain"], transform)
        there = [(row, motion) for row, motion, _ in _key_rows(t, package, (base, tier, quality))]
        if codes.size:
            pairs = zip(there, codes.T.tolist(), strict=True)
            there = [(state_row(row, line, change, motion), motion) for (row, motion), line in pairs]
        return [(*one, depth) for one, depth in zip(there, depths, strict=True)]
    means = grid_means(sidecar.codes, sidecar.classes, sidecar.wider, grid, named["coarser"]).tolist()
    key = Coding(table["key_steps"], factor, t.root["key_gain"], transform, grid.unit)
    rows = [key_row(line, key, mean) for line, mean in zip(codes.T.tolist(), means, strict=True)]
    return list(zip(rows, sidecar.classes.tolist(), depths, strict=True))


def _float32(values: Sequence[Any]) -> bytes:
    flat = [number for row in values for number in (row if isinstance(row, list) else [row])]
    return struct.pack(f"<{len(flat)}f", *flat)
