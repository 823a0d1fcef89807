"""Who chooses: pure functions from what the player knows to a choice with its reason."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from airgs_codec.errors import ConfigError
from airgs_codec.play.link import HEADER_BYTES
from airgs_codec.play.select import Decision, Ladder, Point, select

SAFETY = 0.9  # share of the estimated throughput that is spent
HALF_LIVES_S = (3.0, 8.0)  # of the two throughput averages; the smaller one counts (as in dash.js)
BUFFER_SHARE = 0.5  # of the buffered time that one segment may use


@dataclass(frozen=True, slots=True)
class Download:
    """A finished batch, as the throughput estimate sees it."""

    bytes: int
    seconds: float  # from the first byte to the last


@dataclass(frozen=True, slots=True)
class PlayerState:
    """What is known when something is to be requested."""

    now_s: float
    deadline_s: float  # when it must be there to be shown in time
    segment_s: float  # duration of what it shows
    rtt_s: float
    history: tuple[Download, ...]  # oldest first
    files: int  # files of the batch, each with headers
    options: tuple[Point, ...]  # level counts from 0, best first as the package lists them


def estimate_throughput(history: Sequence[Download]) -> float:
    """bit/s: the smaller of two exponential averages weighted by download time; 0 before the first download."""
    estimates = []
    for half_life in HALF_LIVES_S:
        value, weight = 0.0, 0.0
        for download in history:
            keep = 0.5 ** (download.seconds / half_life)
            value = keep * value + (1 - keep) * 8 * download.bytes / download.seconds
            weight = keep * weight + (1 - keep)
        estimates.append(value / weight if weight > 0 else 0.0)
    return min(estimates)


def budget_bytes(state: PlayerState) -> float:
    """What can arrive in time: the paper's B / R over a segment, plus half of the time that is buffered.

    util * B * window / 8 - headers, window = max(segment, BUFFER_SHARE * (deadline - now)) - RTT.
    """
    window = max(state.segment_s, BUFFER_SHARE * (state.deadline_s - state.now_s)) - state.rtt_s
    return SAFETY * estimate_throughput(state.history) * window / 8 - HEADER_BYTES * state.files


def choose_paper(state: PlayerState) -> Decision:
    """Algorithm 1 over the measured sizes and qualities of this very segment.

    Without the cliff test: it belongs to the dense level space that a package's few levels were taken from, and a rung
    it removed here could only be replaced by a stall.
    """
    return select(Ladder.build(state.options, beta=math.inf, cliff_db=math.inf), budget_bytes(state))


def choose_fixed(state: PlayerState, level: int) -> Decision:
    """Always the same level."""
    return Decision(level, True, "fixed", state.options[level].size_bytes)


def parse_policy(text: str, levels: int) -> tuple[str, int]:
    """'paper' -> ('paper', 0); 'fixed:J' -> ('fixed', J). Raises ConfigError."""
    name, _, number = text.partition(":")
    if text == "paper":
        return "paper", 0
    if name == "fixed" and number.isdigit() and int(number) < levels:
        return "fixed", int(number)
    raise ConfigError(f"--policy: expected paper or fixed:0 … fixed:{levels - 1}, got {text!r}")
