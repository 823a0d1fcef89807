"""Policies: what they know, the estimates that they share, how each chooses, and their names.

Algorithm 1 of the paper (arXiv 2512.20943) comes with its cases defined, and as printed; each with and without its
cliff test (lines 1 to 11), which says how far a level space is worth going down, whatever the link carries; the search
(lines 12 to 25) takes the best of what is left that fits. Oracles know the trace: yardsticks, see `bound`.

R rungs, P rungs of the segment before (or 1, where they do not matter), B points of the controller's buffer grid.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice, pairwise

import numpy as np
from numpy.typing import NDArray

from airgs_codec._arguments import argument, brief
from airgs_codec.errors import ConfigError
from airgs_codec.play.bound import Slot, solve_horizon
from airgs_codec.play.ladder import DEFAULT_BETA, Decision, Option, build_ladder, frame_budget, select, select_literal
from airgs_codec.play.offers import Keyframes, Offers, SegmentOffer
from airgs_codec.play.trace import Link

SAFETY = 0.9  # share of the estimated throughput that is spent
HALF_LIVES_S = (3.0, 8.0)  # of the two throughput averages; the smaller one counts (as in dash.js)
BUFFER_SHARE = 0.5  # of the buffered time that one segment may use
RESERVE_S = 3.0  # of media time that BOLA and the model-predictive controller keep
# Of the model-predictive controller, in dB times seconds; chosen on the Ghent 4G traces at their own rates.
STALL_DB = 20.0  # cost of a second of waiting; ten times as much changes no mean over LTE or 3G by more than 0.2 dB
SWITCH_DB = 0.25  # cost of a change of quality by 1 dB from one segment to the next
LOW_BUFFER_DB = 1.0  # cost of every second that the buffer is short of RESERVE_S, while it is
HORIZON_S, HORIZON_SEGMENTS = 8.0, 12  # how far it looks, in time and in segments at most
GRID_POINTS = 80  # of the buffer
PAST_DOWNLOADS = 3  # whose worst error discounts the estimate


@dataclass(frozen=True, slots=True)
class Download:
    """A finished batch, as the throughput estimate sees it."""

    bytes: int
    seconds: float  # from the first byte to the last


Floats = NDArray[np.float64]
Coming = tuple[SegmentOffer, Keyframes]  # a segment from this one on, and the keyframes decoded for it


@dataclass(frozen=True, slots=True, eq=False)
class PlayerState:
    """What is known when a segment is to be requested."""

    position: int  # of the segment in the session
    offer: SegmentOffer
    upcoming: Callable[[], Iterator[Coming]]
    decoded: Keyframes  # in this loop over the sequence
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
        return estimate_throughput(self.history)

    @property
    def segment_s(self) -> float:
        return self.offer.seconds

    @property
    def buffer_s(self) -> float:
        """Return the seconds of media ahead of the playhead."""
        return max(0.0, self.deadline_s - self.now_s)


@dataclass(frozen=True, slots=True)
class Policy:
    """A rule that chooses the rung of the next segment, and what else the player may do."""

    name: str
    choose: Callable[[PlayerState], Decision]
    may_abandon: bool = True  # give up downloads that would come too late
    may_replace: bool = True  # fetch better rungs for buffered segments
    needs_quality: bool = True  # only packages with measured quality
    horizon: int = 1  # segments whose sizes it looks at, the next one first; oracles know those of all

    def decide(self, state: PlayerState) -> Decision:
        """Return the choice. Raises ConfigError unless it is a Decision for one of `state.options`."""
        decision = argument(f"policy {self.name}", self.choose(state), Decision, "a Decision")
        indices = [option.index for option in state.options]
        if decision.index not in indices:
            raise ConfigError(f"policy {self.name}: expected the index of one of {indices}, got {decision.index!r}")
        return decision


def estimate_throughput(history: Sequence[Download]) -> float:
    """Return bit/s: the smaller of two exponential averages weighted by download time; 0 without a download."""
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
    """Return the bytes that can arrive in time: the paper's B / R over a segment, or over half of the buffered time.

    SAFETY * B * window / 8, window = max(segment, BUFFER_SHARE * (deadline - now)) - latency. Sizes include headers.
    """
    window = max(state.segment_s, BUFFER_SHARE * (state.deadline_s - state.now_s)) - state.request_latency_s
    return SAFETY * state.throughput_bps * window / 8


def full_ladder(state: PlayerState) -> tuple[Option, ...]:
    """Return the rungs worth having, without the cliff test.

    A rung that the cliff test removes can only be replaced by a larger one, and in the end by a stall.
    """
    return build_ladder(state.options, math.inf)


def choose_fixed(state: PlayerState, rung: int) -> Decision:
    chosen = min(state.options, key=lambda p: (p.index != rung, p.size_bytes))
    return Decision(chosen.index, True, "fixed", chosen.size_bytes)


def choose_throughput(state: PlayerState) -> Decision:
    """Choose the best rung within SAFETY * B over the segment's own length, whatever is buffered."""
    return select(full_ladder(state), SAFETY * state.throughput_bps * state.segment_s / 8)


def choose_bola(state: PlayerState) -> Decision:
    """Choose the rung with the largest (V (u + g) - Q) / size: BOLA-BASIC (Spiteri et al., INFOCOM 2016).

    Utilities come from measured quality, sizes are those of each segment.
    u is quality in dB above the smallest rung (its unit cancels), Q the buffer in seconds. V and g are such that the
    smallest rung is left at RESERVE_S (a third of a smaller buffer) and the best one scores nothing when the buffer is
    full.
    """
    rungs = full_ladder(state)
    if len(rungs) == 1:
        return Decision(rungs[0].index, True, "one rung", rungs[0].size_bytes)
    utility = [p.quality - rungs[-1].quality for p in rungs]
    smallest = rungs[-1].size_bytes
    limit = max(state.buffer_limit_s - state.segment_s, state.segment_s)
    reserve = min(RESERVE_S, limit / 3)
    bend = max(u * smallest / (p.size_bytes - smallest) for u, p in zip(utility, rungs[:-1], strict=False))
    v = (limit - reserve) / (utility[0] + bend)
    g = bend + reserve / v
    scores = [(v * (u + g) - state.buffer_s) / max(1, p.size_bytes) for u, p in zip(utility, rungs, strict=True)]
    chosen = rungs[int(np.argmax(scores))]  # the largest where all are under 0
    return Decision(chosen.index, True, f"buffer {state.buffer_s:.2f} s", chosen.size_bytes)


def choose_paper(state: PlayerState) -> Decision:
    """Run Algorithm 1 over the sizes and qualities of this very segment; if no rung is before the cliff, over all.

    The dense level space of Algorithm 1 is here what a package has of it: the levels of the segment with the finest
    keyframes, by the bytes of their deltas. A segment of two levels has a cliff only where the second is 3 dB worse per
    10 % of the bytes saved; of one level, none. Keyframe qualities have no cliff: they are not updates withheld.
    """
    rungs = state.offer.rungs
    least = build_ladder(state.offer.levels)[-1].size_bytes
    enough = tuple(p for p in state.options if rungs[p.index].delta_bytes >= least)
    return choose_paper_no_cliff(replace(state, options=enough or state.options))


def choose_paper_no_cliff(state: PlayerState) -> Decision:
    """Choose the best rung that fits: only the search of Algorithm 1."""
    return select(full_ladder(state), budget_bytes(state))


def choose_paper_literal(state: PlayerState, beta: float = DEFAULT_BETA) -> Decision:
    """Run Algorithm 1 as printed: C = B / R over the segment, without buffer, round trip or safety factor.

    Its levels are the rungs with the finest keyframes, whole group keyframes in the sizes. No drop is a cliff where
    beta is inf. Where it leaves its answer undefined, the last level is chosen.
    """
    levels = [p for p in state.options if state.offer.rungs[p.index].quality == 0] or list(state.options)
    budget = frame_budget(state.throughput_bps, 1 / state.segment_s)
    answer = select_literal(levels, budget, beta)
    chosen = levels[-1 if answer is None else answer]
    reason = "Algorithm 1 leaves it undefined" if answer is None else f"Algorithm 1 for {budget:.0f} B"
    return Decision(chosen.index, chosen.size_bytes <= budget, reason, chosen.size_bytes)


def discounted_throughput(history: Sequence[Download]) -> float:
    """Return bit/s: harmonic mean of the last downloads over 1 + the worst relative error of predicting them so."""
    rates = [8 * d.bytes / d.seconds for d in history[-2 * PAST_DOWNLOADS :]]
    if not rates:
        return 0.0
    errors = [0.0]
    for i in range(max(1, len(rates) - PAST_DOWNLOADS), len(rates)):
        predicted = _harmonic(rates[max(0, i - PAST_DOWNLOADS) : i])
        errors.append(max(0.0, predicted / rates[i] - 1))
    return _harmonic(rates[-PAST_DOWNLOADS:]) / (1 + max(errors))


def _harmonic(rates: Sequence[float]) -> float:
    return len(rates) / sum(1 / rate for rate in rates)


def choose_robust_mpc(state: PlayerState) -> Decision:
    """Choose the first of the rungs that maximise quality - changes - stalls - low buffer over the next segments.

    Model-predictive control with a discounted throughput estimate (Yin et al., SIGCOMM 2015), which knows the true
    sizes and qualities of what comes (as Puffer, NSDI 2020). Dynamic programming backwards over (rung before, buffer),
    the buffer on a grid, at a constant discounted rate.
    """
    rate = discounted_throughput(state.history)
    if rate <= 0:
        return select(full_ladder(state), 0.0)
    limit_s = state.buffer_limit_s

    def download_s(sizes: NDArray[np.int64]) -> Floats:
        return np.asarray(state.request_latency_s * (sizes > 0) + 8 * sizes / rate)  # 0 bytes are not requested

    segments: list[Coming] = []
    total_s = 0.0
    for offer, decoded in islice(state.upcoming(), HORIZON_SEGMENTS):
        if segments and total_s >= HORIZON_S:
            break
        segments.append((offer, decoded))
        total_s += offer.seconds
    value = np.zeros((len(state.offer.rungs), GRID_POINTS))
    for (before, _), (offer, decoded) in reversed(list(pairwise(segments))):
        value = _values(before, offer, download_s(offer.bytes_after(before, decoded)), limit_s, value)
    rungs = np.array([p.index for p in state.options])
    sizes = np.array([p.size_bytes for p in state.options])
    quality = np.array([p.quality for p in state.options])
    took_s = download_s(sizes)
    change = 0.0 if state.shown_quality is None else np.abs(quality - state.shown_quality)
    stall = np.maximum(took_s - state.buffer_s, 0)
    left = np.minimum(np.maximum(state.buffer_s - took_s, 0) + state.segment_s, limit_s)
    grid_s = np.linspace(0.0, limit_s, GRID_POINTS)
    after = np.array([np.interp(b, grid_s, value[r]) for b, r in zip(left, rungs, strict=True)])
    low = LOW_BUFFER_DB * np.maximum(RESERVE_S - left, 0)
    total = state.segment_s * (quality - SWITCH_DB * change - low) - STALL_DB * stall + after
    best = int(np.lexsort((sizes, -total))[0])
    reason = f"{rate / 1e6:.2f} Mbit/s, buffer {state.buffer_s:.2f} s, {len(segments)} segments ahead"
    return Decision(int(rungs[best]), bool(stall[best] <= 0), reason, int(sizes[best]))


def _values(before: SegmentOffer, offer: SegmentOffer, download_s: Floats, limit_s: float, value: Floats) -> Floats:
    """Return (R, B) the best total from a segment on, by the rung of the previous one and the buffer.

    download_s (P, R), the limit of the buffer, value (R, B) of what follows.
    """
    buffer = np.linspace(0.0, limit_s, GRID_POINTS) - download_s[:, :, None]  # (P, R, B)
    left = np.minimum(np.maximum(buffer, 0) + offer.seconds, limit_s)
    place = left * ((GRID_POINTS - 1) / limit_s)
    at = np.minimum(place.astype(np.intp), GRID_POINTS - 2)
    part = place - at
    rung = np.arange(len(offer.psnr))[None, :, None]
    total = offer.seconds * offer.psnr[None, :, None] + STALL_DB * np.minimum(buffer, 0)
    total = total - offer.seconds * LOW_BUFFER_DB * np.maximum(RESERVE_S - left, 0)
    total = total + value[rung, at] * (1 - part) + value[rung, at + 1] * part
    changes = offer.seconds * SWITCH_DB * np.abs(offer.psnr[None, :] - before.psnr[:, None])  # (R, R)
    return np.asarray((total - changes[:, :, None]).max(axis=1))


def choose_oracle_frame(state: PlayerState, link: Link) -> Decision:
    """Choose the best that the true bandwidth carries in the segment's length: the paper's integer programme."""
    first_s = state.now_s + state.request_latency_s
    budget = link.bytes_between(first_s, state.now_s + max(state.segment_s, state.request_latency_s))
    return select(full_ladder(state), budget)


def choose_oracle_lp(state: PlayerState, link: Link) -> Decision:
    """Choose the rung with the largest share of this segment in the linear programme over all that comes."""
    slots, idle_bytes = upcoming_horizon(state, link)
    solution = solve_horizon(slots, state.decoded, idle_bytes)
    if solution is None:
        return select(full_ladder(state), 0.0)
    wanted = int(solution.rungs[0].argmax())
    chosen = next((p for p in state.options if p.index == wanted), None)
    if chosen is None:
        return select(full_ladder(state), solution.first_bytes)
    return Decision(wanted, True, f"planned for {len(slots)} segments", chosen.size_bytes)


def upcoming_horizon(state: PlayerState, link: Link) -> tuple[list[Slot], float]:
    """Return the segments to come, shown without a stall from the next deadline on, and the idle bytes before each.

    They are at most two buffers long. A pipelined player requests a segment one round trip before the link is free, so
    that only the wait for room in the buffer costs a round trip. Otherwise the link is idle for a round trip before
    every segment; the bytes that it could have carried in that time are taken at the trace's mean rate.
    """
    slots = []
    first_byte_s = state.now_s + state.request_latency_s
    start_s = first_start_s = max(state.deadline_s, first_byte_s)
    for offer, _ in state.upcoming():
        end_s = start_s + offer.seconds
        release_s = max(first_byte_s, end_s - state.buffer_limit_s + link.rtt_s)
        slots.append(Slot(offer, link.bytes_between(0.0, release_s), link.bytes_between(0.0, start_s)))
        start_s = end_s
        if start_s > first_start_s + 2 * state.buffer_limit_s:
            break
    return slots, 0.0 if state.pipelined else link.rtt_s * link.trace.mean_bps / 8


Choose = Callable[[PlayerState], Decision]

DEFAULT_POLICY = "robust-mpc"
RULES: dict[str, Choose] = {
    "paper": choose_paper,
    "paper-no-cliff": choose_paper_no_cliff,
    "paper-literal": choose_paper_literal,
    "paper-literal-no-cliff": partial(choose_paper_literal, beta=math.inf),
    "throughput": choose_throughput,
    "bola": choose_bola,
}
ADAPTIVE = {name: Policy(name, rule) for name, rule in RULES.items()}
ADAPTIVE["robust-mpc"] = Policy("robust-mpc", choose_robust_mpc, horizon=HORIZON_SEGMENTS)
ORACLES = {"oracle-frame": choose_oracle_frame, "oracle-lp": choose_oracle_lp}
POLICY_NAMES = (*ADAPTIVE, *ORACLES)


def make_policy(policy: Policy | Choose | str, offers: Offers, link: Link | None = None) -> Policy:
    """Make a policy of a name, fixed:J (level J with the finest keyframes), fixed:RUNG (such as Q1+L3) or a function.

    A value is returned as it is. The oracles need the link. Raises ConfigError for other names, and for an oracle
    without a link.
    """
    if callable(policy):
        policy = Policy(getattr(policy, "__name__", type(policy).__name__), policy)
    if isinstance(policy, Policy):
        return policy
    name = argument("policy", policy, str, "a name, a function from PlayerState to Decision or a Policy")
    if name in ADAPTIVE:
        return ADAPTIVE[name]
    if name in ORACLES:
        if link is None:
            raise ConfigError(f"policy {name}: expected a trace, which it knows in advance, got a real connection")
        return Policy(name, partial(ORACLES[name], link=link), may_replace=False)
    levels = len(offers.manifest.levels)
    fixed = {f"fixed:{rung}": index for index, rung in enumerate(offers.names)}
    fixed |= {f"fixed:{level}": level for level in range(levels)}
    if name not in fixed:
        names = f"{', '.join(POLICY_NAMES)}, fixed:0 … fixed:{levels - 1} or fixed:{offers.names[-1]}"
        raise ConfigError(f"policy: expected {names}, got {name!r}")
    return Policy(name, partial(choose_fixed, rung=fixed[name]), False, False, needs_quality=False)
