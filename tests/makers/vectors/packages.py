"""Whole packages of the repository: which files hold what, what is in them, and the frames that they show.

Codes are those of the decoder, which tests/golden pins; what they mean is computed by the formulas. Tables are read as
FORMAT.md, section 2, says and without the package's own reader.
"""

from __future__ import annotations

import gzip
import json
from dataclasses import dataclass
from hashlib import sha256
from itertools import accumulate
from pathlib import Path
from typing import Any

import numpy as np

from airgs_codec.coding.atlas import slope_times
from airgs_codec.coding.sidecar import grid_means
from airgs_codec.media.h264 import open_segment
from tests.faces import Package, decode_pictures, open_package
from tests.makers.vectors.values import (
    ATTRIBUTES,
    STATIC,
    Coding,
    Rows,
    delta_rows,
    keyframe_rows,
    listed,
    unpack_transform,
)
from tests.support.digests import decode_keyframe, decode_slopes
from tests.support.paths import GOLDEN, REPOSITORY, VALID
from tests.support.vectors import Table, binary

FOX, FINE, ROOM, LINED = GOLDEN / "fox", GOLDEN / "fox-fine", GOLDEN / "room", VALID / "slopes"
INDEXED = (FOX, VALID / "paged", VALID / "live", VALID / "two-groups-sh1", VALID / "inter", ROOM)
SHOWN: dict[Path, list[tuple[int, int, int, int]]] = {  # frame, keyframe quality, level, keyframe tiers
    FOX: [*((frame, q, j, 2) for frame in (0, 3) for q in (0, 1) for j in (0, 1)), (3, 0, 0, 1), (1, 1, 1, 1)],
    FINE: [(1, 0, 0, 2)],
    ROOM: [(0, 0, 0, 2), (2, 0, 0, 2), (3, 1, 1, 2), (3, 0, 0, 1)],
    LINED: [(1, 0, 0, 2), (5, 1, 1, 2)],
}
INDEX = (65, 4095, 4096, 4097, 86_400)  # groups of packages that are no more than their index
SOME = 0, 63, 64  # of many groups, those that are in the vectors
EVERY = 16  # rows of which one is in the vectors
PAGE = 64  # groups, or pages of the level below, on a page of the index


def pages_to(group: int, count: int) -> list[str]:
    """The pages that lead to a group, counted from 0, of so many: those of its place that are full."""
    numbers = [(level, group // PAGE**level) for level in range(9, 0, -1)]
    return [f"index/{level}/{number + 1}.json" for level, number in numbers if number < count // PAGE**level]


@dataclass(frozen=True)
class Tables:
    """airgs.json and the tables of groups, which count from 0 here."""

    name: str
    root: dict[str, Any]
    groups: list[dict[str, Any]]

    @staticmethod
    def of(folder: Path) -> Tables:
        root = json.loads((folder / "airgs.json").read_text())
        count = sum(len(columns["bytes"]) * PAGE**level for level, columns in enumerate(root["index"]))
        paths = (folder / f"group/{number}.json.gz" for number in range(1, count + 1))
        groups = [json.loads(gzip.decompress(path.read_bytes())) for path in paths]
        return Tables(folder.relative_to(REPOSITORY).as_posix(), root, groups)

    def place(self, frame: int) -> tuple[int, int, int]:
        """The group that shows a frame, the segment of its group, and that of the package."""
        group = next(g for g, table in enumerate(self.groups) if frame < table["stop"])
        segment = next(s for s, segment in enumerate(self.groups[group]["segments"]) if frame < segment["stop"])
        return group, segment, self.firsts[group] + segment

    @property
    def firsts(self) -> list[int]:
        return list(accumulate((len(table["segments"]) for table in self.groups), initial=0))

    def sidecar(self, group: int, tier: int) -> str | None:
        """The sidecar of a keyframe tier; None where it has no rows."""
        return f"keyframe/T{tier}/{group + 1}.bin" if self.groups[group]["tiers"][tier]["count"] else None

    def picture(self, group: int, tier: int, quality: int) -> str | None:
        """The picture of a keyframe tier; None where it has none."""
        entry = self.groups[group]["tiers"][tier]
        return f"keyframe/T{tier}/Q{quality}/{group + 1}.m4s" if entry["qualities"][quality]["rows"] else None

    def base_of(self, group: int) -> int | None:
        """The group that its keyframes are differences to; None where they are none."""
        base: int | None = self.groups[group].get("base")
        return None if base is None else base - 1

    def delta(self, group: int, segment: int, level: int) -> str | None:
        """The pictures of a segment of the group; None where there is nothing to fetch."""
        found = self.groups[group]["segments"][segment]["levels"][level]["file"]["bytes"]
        return f"delta/L{level}/{self.firsts[group] + segment + 1}.m4s" if found else None

    def first_files(self, frame: int, quality: int, level: int, tiers: int) -> list[str]:
        """What a viewer fetches, in order, until it shows its first frame with so many keyframe tiers."""
        group, segment, _ = self.place(frame)
        base, count = self.base_of(group), len(self.groups)
        found: list[str | None] = ["airgs.json", *pages_to(group, count), f"group/{group + 1}.json.gz"]
        if base is not None:
            found += [page for page in pages_to(base, count) if page not in found]
            found.append(f"group/{base + 1}.json.gz")
        for tier in range(tiers):
            for one in (group,) if base is None else (group, base):
                found += [self.sidecar(one, tier), self.picture(one, tier, quality)]
        found.append(self.delta(group, segment, level))
        return [path for path in found if path]


def tables() -> tuple[Table, bytes]:
    """The table of cases, and the float32 values of frames."""
    frames, data = [], b""
    for folder, view in ((folder, view) for folder, views in SHOWN.items() for view in views):
        case, numbers = _frame(folder, *view)
        frames.append({**case, "offset": len(data)})
        data += numbers
    indexed = [Tables.of(folder) for folder in INDEXED]
    return {
        "groups": [_group(t, g) for t in indexed for g in range(len(t.groups)) if len(t.groups) < 5 or g in SOME],
        "index": [_place(count, group) for count in INDEX for group in sorted({0, count // 2, count - 65, count - 1})],
        "startup": [start for t in indexed for start in _startups(t)],
        "units": [_unit(of, path) for of in (FOX, VALID / "inter") for path in sorted(of.rglob("*.m4s"))],
        "frames": frames,
    }, data


def _group(t: Tables, group: int) -> dict[str, Any]:
    table, tiers = t.groups[group], range(t.root["tiers"])
    qualities, levels = range(len(t.root["qualities"])), range(len(t.root["levels"]))
    segments = [
        {"start": s["start"], "stop": s["stop"], "files": [t.delta(group, number, j) for j in levels]}
        for number, s in enumerate(table["segments"])
    ]
    return {
        "package": t.name, "number": group + 1, "start": table["start"], "stop": table["stop"],
        "pages": pages_to(group, len(t.groups)), "table": f"group/{group + 1}.json.gz",
        "sidecars": [t.sidecar(group, k) for k in tiers],
        "pictures": [[t.picture(group, k, q) for q in qualities] for k in tiers], "segments": segments,
    }  # fmt: skip


def _place(count: int, group: int) -> dict[str, Any]:
    """Where a group is, counted from 0, in an index of so many, of which each has one frame."""
    entries = [count // PAGE**level % PAGE for level in range(9) if count >= PAGE**level]
    return {"count": count, "entries": entries, "frame": group, "number": group + 1, "pages": pages_to(group, count)}


def _startups(t: Tables) -> list[dict[str, Any]]:
    """The first frame of the package and the last, at the best rung and at the least."""
    rungs = sorted({(0, 0), (len(t.root["qualities"]) - 1, len(t.root["levels"]) - 1)})
    views = [
        {"frame": frame, "quality": quality, "level": level, "tiers": tiers}
        for frame in sorted({0, t.root["frames"] - 1})
        for quality, level in rungs
        for tiers in sorted({1, t.root["levels"][level]["tiers"]})
    ]
    return [{"package": t.name, **view, "files": t.first_files(**view)} for view in views]


def _unit(folder: Path, file: Path) -> dict[str, Any]:
    columns, shown = open_segment(file.read_bytes(), file.name)
    pictures = list(shown)
    height, width = pictures[0].shape
    names = {"package": folder.relative_to(REPOSITORY).as_posix(), "path": file.relative_to(folder).as_posix()}
    size = {"columns": None if columns is None else binary(columns), "width": width, "height": height}
    return names | size | {"luma": [sha256(picture.tobytes()).hexdigest() for picture in pictures]}


def _frame(folder: Path, frame: int, quality: int, level: int, tiers: int) -> tuple[dict[str, Any], bytes]:
    """A frame of a package, and the values of every 16th row of it."""
    t = Tables.of(folder)
    rows = _rows(t, open_package(folder), frame, quality, level, tiers)
    found = listed(rows.take(slice(None, None, EVERY)), limit=True)
    data = b"".join(np.array(found["values"][name], "<f4").tobytes() for name in ATTRIBUTES)
    tolerance = {name: max(found["tolerance"][name]) for name in ATTRIBUTES}
    view = {"frame": frame, "quality": quality, "level": level, "tiers": tiers}
    numbers = list(range(0, len(rows.angles), EVERY))
    return {"package": t.name, **view, "rows": numbers, "tolerance": tolerance}, data


def _rows(t: Tables, package: Package, frame: int, quality: int, level: int, tiers: int) -> Rows:
    group, segment, number = t.place(frame)
    table = t.groups[group]
    parts = [_tier(t, package, group, k, quality) for k in range(tiers) if t.sidecar(group, k)]
    rows = Rows.join([part[0] for part in parts])
    classes, depths = (np.concatenate([part[column] for part in parts]) for column in (1, 2))
    if not t.delta(group, segment, level):
        return rows
    start, stop = (table["segments"][segment][name] for name in ("start", "stop"))
    place = frame - start
    codes = next(decode_pictures(package, number, level, range(place, place + 1))).codes().astype(np.float64)
    if (slopes := decode_slopes(package, number, level)) is not None:
        codes += slope_times(stop - start)[place] * slopes
    carried = np.flatnonzero((depths >= level) & (depths < STATIC))
    changes = np.zeros((len(codes), len(depths)))
    changes[:, carried] = codes[:, : len(carried)]  # of fewer tiers, the first rows
    transform = unpack_transform(table["colour_transform"])
    coding = Coding(table["delta_steps"], t.root["levels"][level]["factor"], t.root["delta_gain"], transform)
    return delta_rows(rows, changes, coding, classes)


def _tier(t: Tables, package: Package, group: int, tier: int, quality: int) -> tuple[Rows, Any, Any]:
    """The canonical values, the motion classes and the depths of the rows of a keyframe tier."""
    codes, sidecar = decode_keyframe(package, group, tier, quality)
    table, named, base = t.groups[group], t.root["qualities"][quality], t.base_of(group)
    grid, transform = package.manifest.groups[group].grid, unpack_transform(table["colour_transform"])
    factor = named["factor"] * table["tiers"][tier]["factor"]
    if base is None:
        means = grid_means(sidecar.codes, sidecar.classes, sidecar.wider, grid, named["coarser"])
        keyframe = Coding(table["keyframe_steps"], factor, t.root["keyframe_gain"], transform, grid.unit)
        return keyframe_rows(codes.astype(np.float64), keyframe, means), sidecar.classes, sidecar.depths
    rows, classes, _ = _tier(t, package, base, tier, quality)
    if codes.size:
        steps = table["keyframe_steps"] | {"means": table["grid"]["step"] * 2.0 ** -table["grid"]["finest"]}
        change = Coding(steps, factor, t.root["keyframe_gain"], transform)
        rows = delta_rows(rows, codes.astype(np.float64), change, classes)
    return rows, classes, sidecar.depths
