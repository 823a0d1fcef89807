"""Who chooses: pure functions from what the player knows to a rung with its reason.

paper, paper-literal: Algorithm 1 (arXiv 2512.20943) with its cases defined, and as printed. throughput: what the
estimate sustains. bola: Lyapunov optimisation of the buffer (Spiteri et al., INFOCOM 2016), utilities from measured
quality, sizes of each segment. robust-mpc: model-predictive control with a discounted estimate (Yin et al., SIGCOMM
2015) over the true sizes and qualities of what comes (as Puffer, NSDI 2020). oracle-frame, oracle-lp: those that know
the trace, as yardsticks; see `optimum`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from airgs_codec.errors import ConfigError
from airgs_codec.play.bound import Horizon, solve_horizon
from airgs_codec.play.catalogue import Catalogue
from airgs_codec.play.ladder import Decision, Ladder, Option, frame_budget, select, select_literal
from airgs_codec.play.link import Link

SAFETY = 0.9  # share of the estimated throughput that is spent
HALF_LIVES_S = (3.0, 8.0)  # of the two throughput averages; the smaller one counts (as in dash.js)
BUFFER_SHARE = 0.5  # of the buffered time that one segment may use
STALL_DB = 20.0  # quality that a second of waiting is worth (Puffer's coefficient)
SWITCH_DB = 0.25  # to robust-mpc: a change of quality by 1 dB from one segment to the next
LOW_BUFFER_DB, RESERVE_S = 1.0, 3.0  # to the same: every second that the buffer is short of the reserve, while it is
MPC_HORIZON_S, MPC_MOST = 8.0, 12  # looked ahead, and the most segments
MPC_BINS = 80  # of the buffer
MPC_PAST = 3  # downloads whose worst error discounts the estimate

Policy = Callable[["PlayerState"], Decision]


@dataclass(frozen=True, slots=True)
class Download:
    """A finished batch, as the throughput estimate sees it."""

    bytes: int
    seconds: float  # from the first byte to the last


@dataclass(frozen=True, slots=True, eq=False)
class PlayerState:
    """What is known when a segment is to be requested."""

    catalogue: Catalogue
    position: int  # of the segment in the session
    end: int  # positions of the session
    held: Mapping[int, int]  # key quality -> tiers of the segment's group at hand
    options: tuple[Option, ...]  # every rung that can be had, wire bytes
    now_s: float
    deadline_s: float  # when it must be there to be shown in time; in the past when the player waits
    buffer_limit_s: float
    rtt_s: float
    shown_quality: float | None  # dB of the segment before it
    history: tuple[Download, ...]  # oldest first

    @property
    def segment(self) -> int:
        """In the package."""
        return self.position % len(self.catalogue.seconds)

    @property
    def segment_s(self) -> float:
        """Seconds that it shows."""
        return self.catalogue.seconds[self.segment]

    @property
    def buffer_s(self) -> float:
        """Media ahead of the playhead."""
        return max(0.0, self.deadline_s - self.now_s)


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

    SAFETY * B * window / 8, window = max(segment, BUFFER_SHARE * (deadline - now)) - RTT. Sizes include headers.
    """
    window = max(state.segment_s, BUFFER_SHARE * (state.deadline_s - state.now_s)) - state.rtt_s
    return SAFETY * estimate_throughput(state.history) * window / 8


def _ladder(state: PlayerState) -> Ladder:
    """The rungs worth having, without the cliff test.

    The cliff belongs to the dense level space that a package's few levels were taken from, and a rung it removed here
    could only be replaced by a stall.
    """
    return Ladder.build(state.options, beta=math.inf, cliff_db=math.inf)


def choose_paper(state: PlayerState) -> Decision:
    """Algorithm 1 over the measured sizes and qualities of this very segment."""
    return select(_ladder(state), budget_bytes(state))


def choose_paper_literal(state: PlayerState) -> Decision:
    """Algorithm 1 as printed: C = B / R over the segment, no buffer, round trip or safety; undefined: the last level.

    Its levels are the rungs with the finest keys, whole group keys in the sizes.
    """
    levels = [p for p in state.options if p.index < len(state.catalogue.manifest.levels)] or list(state.options)
    budget = frame_budget(estimate_throughput(state.history), 1 / state.segment_s)
    answer = select_literal(levels, budget)
    chosen = levels[-1 if answer is None else answer]
    fits = chosen.size_bytes <= budget
    reason = "Algorithm 1 leaves it undefined" if answer is None else f"Algorithm 1 for {budget:.0f} B"
    return Decision(chosen.index, fits, reason, chosen.size_bytes)


def choose_throughput(state: PlayerState) -> Decision:
    """The best that the estimate sustains: SAFETY * B over the segment's own length, whatever is buffered."""
    return select(_ladder(state), SAFETY * estimate_throughput(state.history) * state.segment_s / 8)


def choose_bola(state: PlayerState) -> Decision:
    """BOLA-BASIC: the rung with the largest (V (u + g) - Q) / size.

    u is quality in nepers above the smallest rung, Q the buffer in seconds. V and g are such that the smallest rung is
    left at RESERVE_S (a third of a smaller buffer) and the best one scores nothing when the buffer is full.
    """
    points = _ladder(state).options
    if len(points) == 1:
        return Decision(points[0].index, True, "one rung", points[0].size_bytes)
    utility = [(p.quality - points[-1].quality) * math.log(10) / 20 for p in points]
    smallest = points[-1].size_bytes
    limit = max(state.buffer_limit_s - state.segment_s, state.segment_s)
    reserve = min(RESERVE_S, limit / 3)
    bend = max(u * smallest / (p.size_bytes - smallest) for u, p in zip(utility, points[:-1], strict=False))
    v = (limit - reserve) / (utility[0] + bend)
    g = bend + reserve / v
    scores = [(v * (u + g) - state.buffer_s) / max(1, p.size_bytes) for u, p in zip(utility, points, strict=True)]
    best = 0 if max(scores) <= 0 else int(np.argmax(scores))
    chosen = points[best]
    return Decision(chosen.index, True, f"buffer {state.buffer_s:.2f} s", chosen.size_bytes)


def discounted_throughput(history: Sequence[Download]) -> float:
    """bit/s: harmonic mean of the last MPC_PAST downloads over 1 + the worst relative error of predicting them so."""
    rates = [8 * d.bytes / d.seconds for d in history[-2 * MPC_PAST :]]
    if not rates:
        return 0.0
    errors = [0.0]
    for i in range(max(1, len(rates) - MPC_PAST), len(rates)):
        predicted = _harmonic(rates[max(0, i - MPC_PAST) : i])
        errors.append(max(0.0, predicted / rates[i] - 1))
    return _harmonic(rates[-MPC_PAST:]) / (1 + max(errors))


def _harmonic(rates: Sequence[float]) -> float:
    return len(rates) / sum(1 / rate for rate in rates)


def choose_robust_mpc(state: PlayerState) -> Decision:
    """The first of the rungs that maximise quality - changes - stalls - want of a reserve over the next segments.

    Dynamic programming backwards over (rung before, buffer), the buffer on a grid of MPC_BINS, true sizes and
    qualities, at a constant discounted rate. In dB times seconds: the coefficients were chosen on the Ghent 4G traces,
    none of which is in the studies of the README.
    """
    rate = discounted_throughput(state.history)
    if rate <= 0:
        return select(_ladder(state), 0.0)
    c = state.catalogue
    steps = list(c.upcoming(state.position, MPC_MOST, state.end))
    taken = next((i for i in range(len(steps)) if sum(c.seconds[s] for s, _ in steps[:i]) >= MPC_HORIZON_S), len(steps))
    grid = np.linspace(0.0, state.buffer_limit_s, MPC_BINS)
    value = np.zeros((len(c.rungs), MPC_BINS))  # of what follows, by the last rung and the buffer it left
    for i in range(max(1, taken) - 1, 0, -1):
        s, opens = steps[i]
        sizes = c.bytes_from_scratch[s][None] if opens else c.bytes_after[s]
        before = c.quality[steps[i - 1][0]]
        value = _mpc_step(sizes, c.quality[s], before, c.seconds[s], grid, rate, state, value)
    levels = np.array([p.index for p in state.options])
    sizes = np.array([p.size_bytes for p in state.options])
    quality = np.array([p.quality for p in state.options])
    took = state.rtt_s * (sizes > 0) + 8 * sizes / rate
    change = 0.0 if state.shown_quality is None else np.abs(quality - state.shown_quality)
    stall = np.maximum(took - max(0.0, state.deadline_s - state.now_s), 0)
    left = np.minimum(np.maximum(state.buffer_s - took, 0) + state.segment_s, state.buffer_limit_s)
    after = np.array([np.interp(b, grid, value[r]) for b, r in zip(left, levels, strict=True)])
    thin = LOW_BUFFER_DB * np.maximum(RESERVE_S - left, 0)
    total = state.segment_s * (quality - SWITCH_DB * change - thin) - STALL_DB * stall + after
    best = int(np.lexsort((sizes, -total))[0])
    reason = f"{rate / 1e6:.2f} Mbit/s, buffer {state.buffer_s:.2f} s, {max(1, taken)} segments ahead"
    return Decision(int(levels[best]), bool(stall[best] <= 0), reason, int(sizes[best]))


def _mpc_step(
    sizes: NDArray[np.int64],
    quality: NDArray[np.float64],
    before: NDArray[np.float64],
    seconds: float,
    grid: NDArray[np.float64],
    rate: float,
    state: PlayerState,
    value: NDArray[np.float64],
) -> NDArray[np.float64]:
    """(R, B) best total from here on, by the rung before and the buffer; sizes (1 or R, R), value (R, B)."""
    took = state.rtt_s * (sizes > 0) + 8 * sizes / rate  # (P, R)
    buffer = grid[None, None] - took[:, :, None]  # (P, R, B)
    left = np.minimum(np.maximum(buffer, 0) + seconds, state.buffer_limit_s)
    place = left * ((len(grid) - 1) / state.buffer_limit_s)
    at = np.minimum(place.astype(np.intp), len(grid) - 2)
    part = place - at
    rung = np.arange(len(quality))[None, :, None]
    gained = seconds * quality[None, :, None] + STALL_DB * np.minimum(buffer, 0)
    gained = gained - seconds * LOW_BUFFER_DB * np.maximum(RESERVE_S - left, 0)
    gained = gained + value[rung, at] * (1 - part) + value[rung, at + 1] * part
    changes = seconds * SWITCH_DB * np.abs(quality[None, :] - before[:, None])  # (R, R)
    return np.asarray((gained - changes[:, :, None]).max(axis=1))


def choose_fixed(state: PlayerState, rung: int) -> Decision:
    """Always the same rung; the smallest one where it cannot be had."""
    chosen = next((p for p in state.options if p.index == rung), None)
    chosen = chosen or min(state.options, key=lambda p: p.size_bytes)
    return Decision(chosen.index, True, "fixed", chosen.size_bytes)


def choose_oracle_frame(state: PlayerState, link: Link) -> Decision:
    """The paper's integer programme with the true bandwidth: the best that fits the next segment's length of time."""
    budget = link.bytes_between(state.now_s + state.rtt_s, state.now_s + max(state.segment_s, state.rtt_s))
    return select(_ladder(state), budget)


def choose_oracle_lp(state: PlayerState, link: Link) -> Decision:
    """The rung that the linear programme over all that comes gives most of this segment to.

    It knows the trace; the round trip of every segment is taken off the capacity at the trace's mean rate.
    """
    deadline = max(state.deadline_s, state.now_s + state.rtt_s)
    horizon = Horizon.ahead(state.catalogue, link, state.position, state.end, dict(state.held), deadline, state)
    plan = solve_horizon(horizon)
    if plan is None:
        return select(_ladder(state), 0.0)
    wanted = int(plan.rungs[0].argmax())
    chosen = next((p for p in state.options if p.index == wanted), None)
    if chosen is None:
        return select(_ladder(state), plan.first_bytes)
    return Decision(wanted, True, f"planned for {len(horizon.units)} segments", chosen.size_bytes)


SIMPLE: dict[str, Policy] = {
    "paper": choose_paper,
    "paper-literal": choose_paper_literal,
    "throughput": choose_throughput,
    "bola": choose_bola,
    "robust-mpc": choose_robust_mpc,
}
ORACLES: dict[str, Callable[[PlayerState, Link], Decision]] = {
    "oracle-frame": choose_oracle_frame,
    "oracle-lp": choose_oracle_lp,
}
NAMES = (*SIMPLE, *ORACLES)


def make_policy(text: str, catalogue: Catalogue, link: Link) -> Policy:
    """A policy by name, or fixed:J (level J with the finest keys) or fixed:RUNG (such as Q1+L3). Raises ConfigError."""
    name, _, rung = text.partition(":")
    if text in SIMPLE:
        return SIMPLE[text]
    if text in ORACLES:
        oracle = ORACLES[text]
        return lambda state: oracle(state, link)
    if name == "fixed" and rung in catalogue.names:
        return partial(choose_fixed, rung=catalogue.names.index(rung))
    if name == "fixed" and rung.isdigit() and int(rung) < len(catalogue.manifest.levels):
        return partial(choose_fixed, rung=int(rung))
    names = f"{', '.join(NAMES)}, fixed:0 … fixed:{len(catalogue.manifest.levels) - 1}"
    raise ConfigError(f"--policy: expected {names} or fixed:{catalogue.names[-1]}, got {text!r}")
