"""Bandwidth over time: piecewise constant, integrated exactly."""

from __future__ import annotations

import csv
import json
import math
import re
from bisect import bisect_left, bisect_right
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from itertools import accumulate, pairwise
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from airgs_codec._arguments import brief, path_argument
from airgs_codec.errors import ConfigError, TransportError
from airgs_codec.places.whole import expect_plain

MAHIMAHI_PACKET_BYTES = 1500  # one delivery opportunity
CONSTANT_S = 3600.0
MARKOV_S, MARKOV_DWELL_S, MARKOV_OUTAGE_S, MARKOV_MEAN_BPS = 300.0, 3.0, 1.5, 8e6  # of synthetic traces
MAHIMAHI_MAX_MS = 86_400_000  # a day; a file with larger numbers is something else

DEFAULT_RTT_S = 0.08  # median ping of LTE driving measurements
LONGEST_S = 86_400.0  # of one batch: a stall is counted in frames, and those of years fill the memory
PHONE_BPS = 1e9  # more in a second of a file is a mistaken unit
RATE_UNIT = re.compile(r"(?<![A-Za-z])([kKmMgG]?)(b|B|bits?|bytes?)(?:ps|/s|_(?:per_)?s)")
RATE, UPLOAD = re.compile("throughput|bandwidth|rate|downl|dl_|bps|b/s|bits?|byte"), re.compile("ul|up")
MOST_BPS = 1e19  # beyond, the bound of a session has numbers that HiGHS takes for infinite
TRACE_ENDS = ("loop", "hold", "error")  # what follows the last second: the first one, the last rate, or nothing


@dataclass(frozen=True, slots=True, eq=False)
class Trace:
    """Bandwidth over time: rates_bps[i] holds from starts_s[i] to the next start, the last to duration_s.

    Then comes what `end` says. Raises TransportError for times, rates or an end that cannot be.
    """

    name: str
    starts_s: NDArray[np.float64]  # (K,) ascending from 0
    rates_bps: NDArray[np.float64]  # (K,) bit/s
    duration_s: float
    end: str = "loop"  # of TRACE_ENDS
    rtt_s: float | None = None  # round trip, where the measurement has one

    __repr__ = brief

    _starts: list[float] = field(init=False, repr=False)
    _totals: list[float] = field(init=False, repr=False)  # (K + 1,) bits delivered up to each start, and to the end

    def __post_init__(self) -> None:
        steps = np.diff(self.starts_s, append=self.duration_s)
        if not len(self.starts_s) or self.starts_s[0] != 0 or not (steps > 0).all():
            raise TransportError(f"{self.name}: expected times that ascend from 0")
        if not ((self.rates_bps >= 0) & (self.rates_bps <= MOST_BPS)).all():
            raise TransportError(f"{self.name}: expected finite rates of 0 or more, at most {MOST_BPS:g} bit/s")
        if not self.rates_bps.any():
            raise TransportError(f"{self.name}: the rate is zero all the time, nothing would ever arrive")
        if self.end not in TRACE_ENDS:
            raise TransportError(f"{self.name}: expected an end of {', '.join(TRACE_ENDS)}, got {self.end}")
        object.__setattr__(self, "_starts", self.starts_s.tolist())
        object.__setattr__(self, "_totals", list(accumulate((self.rates_bps * steps).tolist(), initial=0.0)))

    @staticmethod
    def open(source: str | Path) -> Trace:
        """Open the bandwidth trace that `source` names: a file for `read_trace`, `const:MBPS`, a constant rate, or
        `markov:SEED[:MEAN_MBPS]`, a synthetic one. Raises TransportError for a file that cannot be read and for
        anything else.
        """
        kind, *numbers = str(path_argument("trace", source)).split(":")
        if kind not in ("const", "markov"):
            return read_trace(Path(source))
        try:
            if kind == "markov":
                return markov_trace(int(numbers[0]), *(1e6 * float(number) for number in numbers[1:]))
            (mbps,) = numbers
            return Trace(str(source), np.zeros(1), np.array([1e6 * float(mbps)]), CONSTANT_S)
        except (ValueError, LookupError, TypeError) as error:
            raise TransportError(f"{source}: expected const:MBPS or markov:SEED[:MEAN_MBPS]") from error

    @staticmethod
    def from_arrays(seconds: ArrayLike, mbit_s: ArrayLike, name: str = "arrays") -> Trace:
        """Make a trace of K ascending times (K,), of which the first counts as 0, and the rates from each on (K,).

        The last one holds as long as the one before it; a single one for a second. Raises TransportError for arrays of
        other shapes and for what cannot be.
        """
        try:
            times, rates = np.asarray(seconds, np.float64), np.asarray(mbit_s, np.float64)
        except (TypeError, ValueError) as error:
            raise TransportError(f"{name}: expected seconds and Mbit/s: {error}") from error
        if times.ndim != 1 or times.shape != rates.shape or not len(times):
            raise TransportError(f"{name}: expected as many seconds as Mbit/s, got {times.shape} and {rates.shape}")
        last = times[-1] - times[-2] if len(times) > 1 else 1.0
        return _trace(name, times - times[0], 1e6 * rates, float(last))

    @property
    def mean_bps(self) -> float:
        return self._totals[-1] / self.duration_s

    def rate_at(self, at_s: float) -> float:
        """Return bit/s at a time, 0 after the end of a trace that ends."""
        if at_s >= self.duration_s and self.end != "loop":
            return float(self.rates_bps[-1]) if self.end == "hold" else 0.0
        return float(self.rates_bps[bisect_right(self._starts, at_s % self.duration_s) - 1])

    def bits_until(self, at_s: float) -> float:
        rounds, remainder = divmod(at_s, self.duration_s)
        if rounds > 0 and self.end != "loop":
            return self._totals[-1] + self.rate_at(at_s) * (at_s - self.duration_s)
        i = bisect_right(self._starts, remainder) - 1
        return rounds * self._totals[-1] + self._totals[i] + float(self.rates_bps[i]) * (remainder - self._starts[i])

    def arrival_s(self, size_bytes: float, at_s: float) -> float:
        """Return when `size_bytes` have passed, the first bit at `at_s`: the inverse of the integral.

        Infinity where the trace would repeat more than 2^53 times, which float64 cannot count.
        Raises TransportError when the trace ends before, or holds a rate of zero for ever.
        """
        totals = self._totals
        target = self.bits_until(at_s) + 8 * size_bytes
        if target > totals[-1] and self.end != "loop":
            rate = self.rate_at(math.inf)
            if rate <= 0:
                left = f"{(target - totals[-1]) / 8:.0f} bytes still to come"
                raise TransportError(f"{self.name}: ends after {self.duration_s:g} s ({self.end}) with {left}")
            return max(at_s, self.duration_s + (target - totals[-1]) / rate)
        if target > 2.0**53 * totals[-1]:
            return math.inf
        rounds = math.floor(target / totals[-1])
        remainder = min(target - rounds * totals[-1], totals[-1])  # more is rounding of the products
        if remainder <= 0 and rounds > 0:  # done exactly at the end of a round: when its last bit came
            rounds, remainder = rounds - 1, totals[-1]
        i = max(0, bisect_left(totals, remainder) - 1)
        rate = float(self.rates_bps[i])
        inside = (remainder - totals[i]) / rate if rate > 0 else 0.0
        return max(at_s, rounds * self.duration_s + self._starts[i] + inside)

    def cut(self, offset_s: float = 0.0, scale: float = 1.0) -> Trace:
        """Return the trace begun at `offset_s` (what lies before comes last), its rates times `scale`."""
        if not (0 <= offset_s < self.duration_s):
            raise TransportError(f"{self.name}: expected an offset in [0, {self.duration_s:g}) s, got {offset_s:g}")
        if not 0 < scale * self.mean_bps <= MOST_BPS:
            raise TransportError(f"{self.name}: expected a positive scale of rates that links have, got {scale:g}")
        first = int(np.searchsorted(self.starts_s, offset_s, side="right")) - 1
        later, earlier = self.starts_s[first:] - offset_s, self.starts_s[: first + 1] + self.duration_s - offset_s
        starts = np.concatenate([np.maximum(later, 0), earlier])
        rates = np.concatenate([self.rates_bps[first:], self.rates_bps[: first + 1]]) * scale
        inside = starts < self.duration_s
        return replace(self, starts_s=starts[inside], rates_bps=rates[inside])


@dataclass(frozen=True, slots=True, eq=False)
class Link:
    """Files of one batch are requested together: they share a round trip, and then the link in equal parts.

    Raises ConfigError for a round trip that is negative, infinite or no number.
    """

    trace: Trace
    rtt_s: float = DEFAULT_RTT_S

    def __post_init__(self) -> None:
        if not 0 <= self.rtt_s < math.inf:
            raise ConfigError(f"round trip: expected 0 s or more, got {self.rtt_s:g}")

    @staticmethod
    def over(trace: Trace, rtt_s: float | None = None) -> Link:
        given = trace.rtt_s if rtt_s is None else rtt_s
        return Link(trace, DEFAULT_RTT_S if given is None else given)

    def arrival_s(self, wire_bytes: float, first_s: float) -> float:
        """Return when the last byte of a batch has passed whose first one passes at `first_s`.

        Raises TransportError for a trace that ends too soon, and for a batch that takes longer than LONGEST_S.
        """
        end_s = self.trace.arrival_s(wire_bytes, first_s)
        if not end_s - first_s <= LONGEST_S:
            took = f"{wire_bytes:.0f} bytes would take {end_s - first_s:.3g} s"
            raise TransportError(f"{self.trace.name}: {took}, expected at most {LONGEST_S:g} s")
        return end_s

    def bytes_between(self, start_s: float, stop_s: float) -> float:
        return max(0.0, self.trace.bits_until(stop_s) - self.trace.bits_until(start_s)) / 8


def markov_trace(seed: int, mean_bps: float = MARKOV_MEAN_BPS) -> Trace:
    """Draw a seeded chain over rates a factor of two apart, with outages; a state lasts about MARKOV_DWELL_S.

    Neighbouring rates follow each other, one change in ten falls into an outage of about MARKOV_OUTAGE_S.
    """
    random = np.random.default_rng(seed)
    starts, rates, at, state = list[float](), list[float](), 0.0, 2
    while at < MARKOV_S:
        out = bool(starts) and random.random() < 0.1
        starts.append(at)
        rates.append(0.0 if out else 2.0**state * random.uniform(0.8, 1.25))
        at += random.exponential(MARKOV_OUTAGE_S if out else MARKOV_DWELL_S) + 0.05
        state = int(np.clip(state + random.choice((-1, 0, 1)), 0, 4))
    lengths = np.diff(np.array(starts), append=MARKOV_S)
    scaled = np.array(rates) * mean_bps * MARKOV_S / float(np.dot(rates, lengths))
    return Trace(f"markov:{seed}:{mean_bps / 1e6:g}", np.array(starts), scaled, MARKOV_S)


def read_trace(path: Path) -> Trace:
    """Read a trace file: rows of times and rates (CSV, or Pensieve's with blanks), with names of columns such as
    time_ms or throughput_kbps, or G-NetTrack's, in the first one; sabre JSON; mahimahi (a delivery time in ms a line).

    Raises TransportError for a file that is none of these, is empty, carries nothing, or more than a phone can.
    """
    try:
        expect_plain(path)
        lines = [line for line in path.read_text(encoding="utf-8-sig").splitlines() if line.strip()]
    except (OSError, UnicodeDecodeError) as error:
        raise TransportError(f"{path}: cannot read the trace: {error}") from error
    if not lines:
        raise TransportError(f"{path}: expected a bandwidth trace, got an empty file")
    try:
        if lines[0].lstrip().startswith("["):
            trace = _read_sabre(path.name, json.loads("\n".join(lines)))
        elif all(line.strip().isdigit() for line in lines):
            trace = _read_mahimahi(path.name, [int(line) for line in lines])
        else:
            trace = _read_rows(path.name, lines)
    except (ValueError, LookupError, TypeError, ArithmeticError, RecursionError, csv.Error) as error:
        expected = "expected rows of times and rates, sabre JSON, or mahimahi"
        raise TransportError(f"{path}: {expected}: {error}") from error
    after = np.interp(trace.starts_s + 1, [*trace.starts_s, trace.duration_s], trace._totals)
    if (most := float((after - trace._totals[:-1]).max())) > PHONE_BPS:
        got = f"got {most / 1e9:.3g}: name its unit, such as time_s,throughput_kbps"
        raise TransportError(f"{path}: expected less than {PHONE_BPS / 1e9:g} Gbit/s of a phone, {got}")
    return trace


def _read_rows(name: str, lines: Sequence[str]) -> Trace:
    """Rows of times and rates, in seconds and Mbit/s unless the first row names columns and their units.

    Rows of one moment are averaged, '-' is no reading, a skipped moment keeps the last rate.
    """
    mark = next((mark for mark in ",;\t" if mark in lines[0]), "")
    rows = list(csv.reader(lines, delimiter=mark)) if mark else [line.split() for line in lines]
    when, second, what, bps = 0, 1.0, 1, 1e6
    if rows[0][0].strip()[:1].isalpha():
        when, second, what, bps = _columns([cell.strip() for cell in rows.pop(0)])
    readings: dict[float, list[float]] = {}
    for row in rows:
        if len(row) <= max(when, what):
            raise ValueError(f"no rate in {','.join(row)[:40]!r}")
        if row[what].strip() not in ("-", ""):
            readings.setdefault(second * _moment(row[when]), []).append(bps * float(row[what]))
    if not readings:
        raise ValueError("no readings")
    return Trace.from_arrays(list(readings), [float(np.mean(rates)) / 1e6 for rates in readings.values()], name)


def _columns(names: Sequence[str]) -> tuple[int, float, int, float]:
    """Return which column has times, its unit in seconds, which one has rates, and its unit in bit/s."""
    times = [i for i, n in enumerate(names) if re.match("time|date|sec|elapsed|t(_|$)", n.lower())]
    rates = [i for i, n in enumerate(names) if RATE.search(n.lower()) and not UPLOAD.match(n.lower())]
    if not times or not rates:
        raise ValueError(f"no columns such as time_s and throughput_mbps in {','.join(names)[:60]!r}")
    time, rate = names[times[0]].lower(), names[rates[0]]
    bps = 1e3 if rate == "DL_bitrate" else 1e6  # as G-NetTrack has it, and as files without names
    if unit := RATE_UNIT.search(rate) or RATE_UNIT.search(rate.lower()):
        bps = {"": 1.0, "k": 1e3, "m": 1e6, "g": 1e9}[unit[1].lower()] * (8 if unit[2][:2] in ("B", "by") else 1)
    return times[0], 1e-3 if re.search("[^a-z]ms([^a-z]|$)|milli", time) else 1.0, rates[0], bps


def _moment(text: str) -> float:
    """Return the seconds that a number, ISO 8601 or a stamp of G-NetTrack says; without a zone, summer time is none."""
    if not re.search("_|[0-9]-[0-9]", text):
        return float(text)
    stamp = datetime.strptime(text, "%Y.%m.%d_%H.%M.%S") if "_" in text else datetime.fromisoformat(text.strip())
    return (stamp if stamp.tzinfo else stamp.replace(tzinfo=UTC)).timestamp()


def _read_sabre(name: str, periods: list[dict[str, float]]) -> Trace:
    """Periods of `duration_ms`, `bandwidth_kbps` and `latency_ms`, whose mean is taken for the round trip."""
    lengths = [float(period["duration_ms"]) / 1e3 for period in periods]
    rtts = [float(period["latency_ms"]) / 1e3 for period in periods if "latency_ms" in period]
    starts = list(accumulate(lengths[:-1], initial=0.0))
    trace = _trace(name, starts, [1e3 * float(period["bandwidth_kbps"]) for period in periods], lengths[-1])
    return replace(trace, rtt_s=math.fsum(rtts) / len(rtts)) if rtts else trace


def _read_mahimahi(name: str, times_ms: Sequence[int]) -> Trace:
    """Each line is a chance to deliver one packet in the millisecond before it."""
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
