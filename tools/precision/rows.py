"""Rows of the report, and the file that keeps them, so that a run which was killed goes on where it ended."""

from __future__ import annotations

import json
import math
import os
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np

from airgs_codec._files import write_bytes

T = TypeVar("T")


class Place(NamedTuple):
    """Where in the report a row stands."""

    section: str
    panel: str
    scene: str
    curve: str
    setting: str  # a point of the curve


class Took(NamedTuple):
    """Seconds of a run."""

    cpu: float  # of all threads together
    wall: float

    def times(self, factor: float) -> Took:
        """So many times as long."""
        return Took(self.cpu * factor, self.wall * factor)


@dataclass(frozen=True, slots=True)
class Row:
    """One measurement: medians of repeated runs, with their quartiles."""

    section: str
    panel: str
    scene: str
    curve: str
    setting: str
    seconds: float  # of CPU time, all threads together
    seconds_low: float  # lower quartile
    seconds_high: float  # upper quartile
    error: float  # in `unit`; NaN where nothing can err
    error_low: float
    error_high: float
    unit: str
    wall: float  # seconds by the clock on the wall, median
    bytes: float = math.nan  # a frame; NaN where there are none
    runs: int = 1

    @staticmethod
    def of(place: Place, took: Sequence[Took], errors: Sequence[float], unit: str = "", size: float = math.nan) -> Row:
        """The row of some runs, at least one; `errors` are of runs, too, and none where nothing can err."""
        spread = quartiles([t.cpu for t in took])
        wall = quartiles([t.wall for t in took])[0]
        return Row(*place, *spread, *quartiles(errors or [math.nan]), unit, wall, size, len(took))

    def words(self) -> str:
        """As a line for people."""
        name = f"{self.section}/{self.panel} {self.scene} {self.curve} {self.setting}"
        error = "" if math.isnan(self.error) else f"{self.error:.4g} {self.unit}"
        size = "" if math.isnan(self.bytes) else f"{self.bytes:.0f} B"
        return f"{name:<64}{1e3 * self.seconds:12.3f} ms  {error:<24}{size:>10}"


def quartiles(values: Sequence[float]) -> tuple[float, float, float]:
    """Median, lower and upper quartile."""
    low, middle, high = np.percentile(np.asarray(values, np.float64), [25, 50, 75])
    return float(middle), float(low), float(high)


def timed(work: Callable[[], object], repeats: int) -> list[Took]:
    """What each took of some calls, after one that compiles and fills caches."""
    work()
    return [seconds_of(work)[0] for _ in range(repeats)]


def seconds_of(work: Callable[[], T]) -> tuple[Took, T]:
    """What one call took, and what it gives."""
    cpu, wall = time.process_time(), time.perf_counter()
    result = work()
    return Took(time.process_time() - cpu, time.perf_counter() - wall), result


class Kept:
    """The rows of finished measurements, in a file of one JSON object a line, with the settings they belong to."""

    def __init__(self, path: Path, tell: Callable[[str], None] = lambda line: None, more: bool = True) -> None:
        """A line that was not finished when a run was killed is dropped. `tell` gets every new row in words.

        `more`: whether what is missing is measured.
        """
        self._path, self._tell, self._more = path, tell, more
        self._known: dict[str, list[Row]] = {}
        lines = path.read_text(encoding="utf-8").splitlines(keepends=True) if path.is_file() else []
        whole = [line for line in lines if line.endswith("\n")]
        if len(whole) < len(lines):
            write_bytes(path, "".join(whole).encode())
        for line in whole:
            entry = json.loads(line)
            self._known[_name(entry["settings"])] = [_row(fields) for fields in entry["rows"]]

    def once(self, settings: Mapping[str, Any], work: Callable[[], Iterable[Row]]) -> list[Row]:
        """The rows of a measurement with these settings: those that are kept, else those that `work` gives now."""
        name = _name(settings)
        if not self._more:
            return self._known.get(name, [])
        if name not in self._known:
            rows = list(work())
            entry = {"settings": settings, "rows": [plain(row) for row in rows]}
            with self._path.open("a", encoding="utf-8") as file:
                file.write(json.dumps(entry, sort_keys=True, allow_nan=False) + "\n")
                file.flush()
                os.fsync(file.fileno())
            self._known[name] = rows
            for row in rows:
                self._tell(row.words())
        return self._known[name]


def plain(row: Row) -> dict[str, Any]:
    """The fields of a row as JSON has them: null for NaN."""
    return {name: None if value != value else value for name, value in asdict(row).items()}


def _row(fields: Mapping[str, Any]) -> Row:
    values: dict[str, Any] = {name: math.nan if value is None else value for name, value in fields.items()}
    return Row(**values)


def _name(settings: Mapping[str, Any]) -> str:
    return json.dumps(settings, sort_keys=True)
