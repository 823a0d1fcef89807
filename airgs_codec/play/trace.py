"""Bandwidth over time: piecewise constant, integrated exactly, repeated from the start when it ends."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import datetime
from itertools import accumulate, pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from airgs_codec.errors import TransportError

MAHIMAHI_PACKET_BYTES = 1500  # one delivery opportunity
MAHIMAHI_MAX_MS = 86_400_000  # a day; a file with larger numbers is something else


@dataclass(frozen=True, slots=True, eq=False)
class Trace:
    """rates_bps[i] holds from starts_s[i] to the next start, the last to duration_s; then it begins again."""

    name: str
    starts_s: NDArray[np.float64]  # (K,) ascending from 0
    rates_bps: NDArray[np.float64]  # (K,) bit/s
    duration_s: float
    scale: float = 1.0  # what the measured rates were multiplied by
    offset_s: float = 0.0  # where in the measurement it begins

    def __post_init__(self) -> None:
        steps = np.diff(self.starts_s, append=self.duration_s)
        if not len(self.starts_s) or self.starts_s[0] != 0 or not (steps > 0).all():
            raise TransportError(f"{self.name}: expected times that ascend from 0")
        if not (np.isfinite(self.rates_bps).all() and (self.rates_bps >= 0).all()):
            raise TransportError(f"{self.name}: expected finite rates of 0 or more")
        if not self.rates_bps.any():
            raise TransportError(f"{self.name}: the rate is zero all the time, nothing would ever arrive")

    @property
    def mean_bps(self) -> float:
        """Mean rate over the whole trace."""
        return self._totals()[-1] / self.duration_s

    def _totals(self) -> list[float]:
        """Bits delivered up to each start, and up to the end."""
        steps = np.diff(self.starts_s, append=self.duration_s)
        return list(accumulate((self.rates_bps * steps).tolist(), initial=0.0))

    def bits_until(self, at_s: float) -> float:
        """Integral of the rate from 0 to `at_s`."""
        totals = self._totals()
        rounds, rest = divmod(at_s, self.duration_s)
        i = int(np.searchsorted(self.starts_s, rest, side="right")) - 1
        return rounds * totals[-1] + totals[i] + float(self.rates_bps[i]) * (rest - float(self.starts_s[i]))

    def arrival_s(self, size_bytes: int, at_s: float) -> float:
        """When `size_bytes` have passed, the first bit at `at_s`: the inverse of the integral."""
        totals = self._totals()
        target = self.bits_until(at_s) + 8 * size_bytes
        rounds = math.floor(target / totals[-1])
        rest = target - rounds * totals[-1]
        if rest <= 0 and rounds > 0:  # done exactly at the end of a round: when its last bit came
            rounds, rest = rounds - 1, totals[-1]
        i = max(0, int(np.searchsorted(totals, rest, side="left")) - 1)
        rate = float(self.rates_bps[i])
        inside = (rest - totals[i]) / rate if rate > 0 else 0.0
        return max(at_s, rounds * self.duration_s + float(self.starts_s[i]) + inside)

    def cut(self, offset_s: float = 0.0, scale: float = 1.0) -> Trace:
        """The trace begun at `offset_s` (what lies before comes last), its rates times `scale`."""
        if not (0 <= offset_s < self.duration_s):
            raise TransportError(f"{self.name}: expected an offset in [0, {self.duration_s:g}) s, got {offset_s:g}")
        if not 0 < scale < math.inf:
            raise TransportError(f"{self.name}: expected a positive scale, got {scale:g}")
        first = int(np.searchsorted(self.starts_s, offset_s, side="right")) - 1
        later, earlier = self.starts_s[first:] - offset_s, self.starts_s[: first + 1] + self.duration_s - offset_s
        starts = np.concatenate([np.maximum(later, 0), earlier])
        rates = np.concatenate([self.rates_bps[first:], self.rates_bps[: first + 1]]) * scale
        kept = starts < self.duration_s
        begins = (self.offset_s + offset_s) % self.duration_s
        return Trace(self.name, starts[kept], rates[kept], self.duration_s, self.scale * scale, begins)


def read_trace(path: Path) -> Trace:
    """A trace file: Raca et al. CSV (DL_bitrate), CSV of `time_s,mbps`, or mahimahi (a delivery time in ms a line).

    Raises TransportError for a file that is none of these, is empty, or carries nothing.
    """
    try:
        lines = [line for line in path.read_text(encoding="utf-8-sig").splitlines() if line.strip()]
    except (OSError, UnicodeDecodeError) as error:
        raise TransportError(f"{path}: cannot read the trace: {error}") from error
    if not lines:
        raise TransportError(f"{path}: expected a bandwidth trace, got an empty file")
    try:
        if "DL_bitrate" in lines[0]:
            return _read_raca(path.name, lines)
        if all(line.strip().isdigit() for line in lines):
            return _read_mahimahi(path.name, [int(line) for line in lines])
        return _read_plain(path.name, lines)
    except (ValueError, KeyError, IndexError) as error:
        expected = "expected Raca CSV, time_s,mbps CSV or mahimahi"
        raise TransportError(f"{path}: {expected}: {error}") from error


def _read_raca(name: str, lines: Sequence[str]) -> Trace:
    """G-NetTrack rows about once a second, DL_bitrate in kbit/s.

    Rows of one second are averaged, '-' is no reading, a skipped second keeps the last rate.
    """
    seconds: dict[datetime, list[float]] = {}
    for row in csv.DictReader(lines):
        if row["DL_bitrate"] not in ("-", "", None):
            stamp = datetime.strptime(row["Timestamp"], "%Y.%m.%d_%H.%M.%S")
            seconds.setdefault(stamp, []).append(1e3 * float(row["DL_bitrate"]))
    if not seconds:
        raise ValueError("no DL_bitrate readings")
    stamps = sorted(seconds)
    times = [(s - stamps[0]).total_seconds() for s in stamps]  # naive: a time zone's summer time must not matter
    return _trace(name, times, [float(np.mean(seconds[s])) for s in stamps], 1.0)


def _read_plain(name: str, lines: Sequence[str]) -> Trace:
    rows = [line.replace(",", " ").split() for line in lines]
    if not _is_number(rows[0][0]):
        rows = rows[1:]
    if not rows:
        raise ValueError("no rows after the header")
    if short := next((line for line, row in zip(lines[-len(rows) :], rows, strict=True) if len(row) < 2), None):
        raise ValueError(f"no rate in {short[:40]!r}")
    times = [float(row[0]) for row in rows]
    last = times[-1] - times[-2] if len(times) > 1 else 1.0
    return _trace(name, [t - times[0] for t in times], [1e6 * float(row[1]) for row in rows], last)


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _read_mahimahi(name: str, times_ms: Sequence[int]) -> Trace:
    """Each line is a chance to deliver one packet in the millisecond that ends there."""
    if any(b < a for a, b in pairwise(times_ms)):
        raise ValueError("times do not ascend")
    if times_ms[-1] > MAHIMAHI_MAX_MS:
        raise ValueError(f"a delivery after {times_ms[-1]} ms, more than a day")
    busy, packets = np.unique(np.maximum(np.array(times_ms), 1) - 1, return_counts=True)
    rates = dict.fromkeys([0, *(busy + 1).tolist()], 0.0)  # idle, but where the next line says otherwise
    rates |= dict(zip(busy.tolist(), (packets * MAHIMAHI_PACKET_BYTES * 8 * 1e3).tolist(), strict=True))
    starts = [ms for ms in sorted(rates) if ms <= busy[-1]]
    return _trace(name, [ms / 1e3 for ms in starts], [rates[ms] for ms in starts], 1e-3)


def _trace(name: str, starts: Iterable[float], rates: Iterable[float], last_s: float) -> Trace:
    times = np.array(list(starts), np.float64)
    return Trace(name, times, np.array(list(rates), np.float64), float(times[-1]) + last_s)
