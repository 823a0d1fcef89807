"""What a policy is, what it knows, and the estimates that several policies share."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

from airgs_codec._arguments import argument, brief
from airgs_codec.errors import ConfigError
from airgs_codec.play.ladder import Decision, Ladder, Option
from airgs_codec.play.offers import Keys, SegmentOffer

SAFETY = 0.9  # share of the estimated throughput that is spent
HALF_LIVES_S = (3.0, 8.0)  # of the two throughput averages; the smaller one counts (as in dash.js)
BUFFER_SHARE = 0.5  # of the buffered time that one segment may use
RESERVE_S = 3.0  # of media time that BOLA and the model-predictive controller keep
STALL_DB = 20.0  # quality that a second of waiting is worth (Puffer's coefficient)


@dataclass(frozen=True, slots=True)
class Download:
    """A finished batch, as the throughput estimate sees it."""

    bytes: int
    seconds: float  # from the first byte to the last


Coming = tuple[SegmentOffer, Keys]  # of this segment and each after it, while tables are there: what is decoded for it


@dataclass(frozen=True, slots=True, eq=False)
class PlayerState:
    """What is known when a segment is to be requested."""

    position: int  # of the segment in the session
    offer: SegmentOffer
    upcoming: Callable[[], Iterator[Coming]]
    decoded: Keys  # in this loop over the sequence
    options: tuple[Option, ...]  # every rung that can be had, with its wire bytes
    now_s: float
    deadline_s: float  # when it must arrive to be shown in time; in the past when the player waits
    buffer_limit_s: float
    request_latency_s: float  # from now to the first byte
    pipelined: bool  # requests are sent one round trip before the link is free
    shown_quality: float | None  # dB of the segment before it
    history: tuple[Download, ...]  # oldest first

    __repr__ = brief

    @property
    def throughput_bps(self) -> float:
        """bit/s that `estimate_throughput` makes of the downloads so far."""
        return estimate_throughput(self.history)

    @property
    def segment_s(self) -> float:
        """Seconds that the segment shows."""
        return self.offer.seconds

    @property
    def buffer_s(self) -> float:
        """Seconds of media ahead of the playhead."""
        return max(0.0, self.deadline_s - self.now_s)


@dataclass(frozen=True, slots=True)
class Policy:
    """A rule that chooses the rung of the next segment, and what the player may do beside it."""

    name: str
    choose: Callable[[PlayerState], Decision]
    may_abandon: bool = True  # give up downloads that would come too late
    may_replace: bool = True  # fetch better rungs for buffered segments
    needs_quality: bool = True  # only packages with measured quality
    horizon: int = 1  # segments whose sizes it looks at, the next one first; oracles know those of all

    def decide(self, state: PlayerState) -> Decision:
        """Return what it chooses. Raises ConfigError where that is no Decision for one of `state.options`."""
        decision = argument(f"policy {self.name}", self.choose(state), Decision, "a Decision")
        known = [option.index for option in state.options]
        if decision.index not in known:
            raise ConfigError(f"policy {self.name}: expected the index of one of {known}, got {decision.index!r}")
        return decision


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
    """Bytes that can arrive in time: the paper's B / R over a segment, plus half of the time that is buffered.

    SAFETY * B * window / 8, window = max(segment, BUFFER_SHARE * (deadline - now)) - latency. Sizes include headers.
    """
    window = max(state.segment_s, BUFFER_SHARE * (state.deadline_s - state.now_s)) - state.request_latency_s
    return SAFETY * estimate_throughput(state.history) * window / 8


def full_ladder(state: PlayerState) -> Ladder:
    """The rungs worth having, without the cliff test.

    A rung that the cliff test removes can only be replaced by a larger one, and in the end by a stall.
    """
    return Ladder.build(state.options, beta=math.inf, cliff_db=math.inf)


def before_cliff(state: PlayerState) -> PlayerState:
    """The same with those rungs alone whose level is not past the cliff of its segment; with all, if there are none.

    The dense level space of Algorithm 1 is here what a package has of it: the levels of the segment with the finest
    keys, by the bytes of their states. A segment of two levels has a cliff only where the second is 3 dB worse per
    10 % of the bytes saved; of one level, none. Key qualities have no cliff: they are not updates withheld.
    """
    rungs = state.offer.rungs
    least = Ladder.build(state.offer.levels).options[-1].size_bytes
    enough = tuple(p for p in state.options if rungs[p.index].state_bytes >= least)
    return replace(state, options=enough or state.options)
