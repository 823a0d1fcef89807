"""The tables of a package as plain JSON, read as FORMAT.md, section 2, says and without the package's own reader."""

from __future__ import annotations

import gzip
import json
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

PAGE = 64  # groups, or pages of the level below, on a page of the index


def pages_to(group: int, count: int) -> list[str]:
    """The pages that lead to a group, counted from 0, of so many: those of its place that are full."""
    numbers = [(level, group // PAGE**level) for level in range(9, 0, -1)]
    return [f"index/{level}/{number + 1}.json" for level, number in numbers if number < count // PAGE**level]


@dataclass(frozen=True)
class Tables:
    folder: Path

    @cached_property
    def root(self) -> dict[str, Any]:
        return self._json("airgs.json")

    @cached_property
    def groups(self) -> list[dict[str, Any]]:
        paths = [self.folder / path for path in self.group_paths()]
        return [json.loads(gzip.decompress(path.read_bytes())) for path in paths]

    def group_paths(self) -> Iterator[str]:
        yield from (f"group/{number}.json.gz" for number in range(1, self.count + 1))

    @property
    def count(self) -> int:
        return sum(len(columns["bytes"]) * PAGE**level for level, columns in enumerate(self.root["index"]))

    def pages_to(self, group: int) -> list[str]:
        """The pages that lead to a group, counted from 0, from airgs.json on."""
        return pages_to(group, self.count)

    def segments_before(self, group: int) -> int:
        return sum(len(table["segments"]) for table in self.groups[:group])

    def group_at(self, frame: int) -> int:
        return next(g for g, table in enumerate(self.groups) if frame < table["stop"])

    def segment_at(self, frame: int) -> int:
        """The segment of its group, counted from 0, that shows a frame."""
        segments = self.groups[self.group_at(frame)]["segments"]
        return next(s for s, segment in enumerate(segments) if frame < segment["stop"])

    def sidecar(self, group: int, tier: int) -> str | None:
        """The sidecar of a key tier; None where it has no rows."""
        return f"key/T{tier}/{group + 1}.bin" if self.groups[group]["tiers"][tier]["count"] else None

    def picture(self, group: int, tier: int, quality: int) -> str | None:
        """The picture of a key tier; None where it has none."""
        entry = self.groups[group]["tiers"][tier]
        return f"key/T{tier}/Q{quality}/{group + 1}.m4s" if entry["qualities"][quality]["rows"] else None

    def base_of(self, group: int) -> int | None:
        """The group, counted from 0 as well, that its keys are differences to; None where they are none."""
        keeps: int | None = self.groups[group].get("keeps")
        return None if keeps is None else keeps - 1

    def state(self, group: int, segment: int, level: int) -> str | None:
        """The pictures of a segment of the group; None where there is nothing to fetch."""
        found = self.groups[group]["segments"][segment]["levels"][level]["file"]["bytes"]
        return f"state/L{level}/{self.segments_before(group) + segment + 1}.m4s" if found else None

    def first_files(self, frame: int, quality: int, level: int, tiers: int) -> list[str]:
        """What a viewer fetches, in order, until it shows its first frame with so many key tiers."""
        group = self.group_at(frame)
        found: list[str | None] = ["airgs.json", *self.pages_to(group), list(self.group_paths())[group]]
        base = self.base_of(group)
        if base is not None:
            found += [page for page in self.pages_to(base) if page not in found]
            found.append(list(self.group_paths())[base])
        for tier in range(tiers):
            found += [self.sidecar(group, tier), self.picture(group, tier, quality)]
            if base is not None:
                found += [self.sidecar(base, tier), self.picture(base, tier, quality)]
        found.append(self.state(group, self.segment_at(frame), level))
        return [path for path in found if path]

    def _json(self, path: str) -> dict[str, Any]:
        table: dict[str, Any] = json.loads((self.folder / path).read_text())
        return table
