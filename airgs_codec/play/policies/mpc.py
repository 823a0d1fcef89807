"""Model-predictive control with a discounted throughput estimate (Yin et al., SIGCOMM 2015).

It knows the true sizes and qualities of what comes (as Puffer, NSDI 2020). R rungs, P rungs of the segment before (or
1, where they do not matter), B points of the buffer's grid. Values are in dB times seconds; the coefficients were
chosen on the Ghent 4G traces, none of which is in the studies of the documentation.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import islice, pairwise

import numpy as np
from numpy.typing import NDArray

from airgs_codec.play.ladder import Decision, select
from airgs_codec.play.policies.state import RESERVE_S, STALL_DB, Coming, Download, PlayerState, full_ladder

SWITCH_DB = 0.25  # cost of a change of quality by 1 dB from one segment to the next
LOW_BUFFER_DB = 1.0  # cost of every second that the buffer is short of RESERVE_S, while it is
HORIZON_S, HORIZON_SEGMENTS = 8.0, 12  # how far it looks, in time and in segments at most
GRID_POINTS = 80  # of the buffer
PAST_DOWNLOADS = 3  # whose worst error discounts the estimate


def discounted_throughput(history: Sequence[Download]) -> float:
    """bit/s: harmonic mean of the last downloads over 1 + the worst relative error of predicting them so."""
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


@dataclass(frozen=True, slots=True, eq=False)
class Model:
    """The link and the buffer as the controller takes them to be."""

    rate_bps: float
    latency_s: float  # of every request
    limit_s: float  # of the buffer
    grid_s: NDArray[np.float64]  # (B,) buffers for which values are known

    def download_s(self, sizes: NDArray[np.int64]) -> NDArray[np.float64]:
        """Seconds to fetch so many bytes; nothing is requested for none."""
        return np.asarray(self.latency_s * (sizes > 0) + 8 * sizes / self.rate_bps)

    def value_before(
        self,
        sizes: NDArray[np.int64],
        quality: NDArray[np.float64],
        quality_before: NDArray[np.float64],
        seconds: float,
        value: NDArray[np.float64],
    ) -> NDArray[np.float64]:
        """(R, B) best total from a segment on, by the rung before it and the buffer.

        sizes (P, R) bytes, quality (R,) of the segment and the one before it in dB, value (R, B) of what follows.
        """
        buffer = self.grid_s[None, None] - self.download_s(sizes)[:, :, None]  # (P, R, B)
        left = np.minimum(np.maximum(buffer, 0) + seconds, self.limit_s)
        place = left * ((GRID_POINTS - 1) / self.limit_s)
        at = np.minimum(place.astype(np.intp), GRID_POINTS - 2)
        part = place - at
        rung = np.arange(len(quality))[None, :, None]
        total = seconds * quality[None, :, None] + STALL_DB * np.minimum(buffer, 0)
        total = total - seconds * LOW_BUFFER_DB * np.maximum(RESERVE_S - left, 0)
        total = total + value[rung, at] * (1 - part) + value[rung, at + 1] * part
        changes = seconds * SWITCH_DB * np.abs(quality[None, :] - quality_before[:, None])  # (R, R)
        return np.asarray((total - changes[:, :, None]).max(axis=1))


ValueBefore = Callable[
    [Model, NDArray[np.int64], NDArray[np.float64], NDArray[np.float64], float, NDArray[np.float64]],
    NDArray[np.float64],
]


def choose_robust_mpc(state: PlayerState, value_before: ValueBefore = Model.value_before) -> Decision:
    """The first of the rungs that maximise quality - changes - stalls - want of a reserve over the next segments.

    Dynamic programming backwards over (rung before, buffer), the buffer on a grid, at a constant discounted rate.
    `value_before` is one step of it, for whoever has a faster one.
    """
    rate = discounted_throughput(state.history)
    if rate <= 0:
        return select(full_ladder(state), 0.0)
    limit_s = state.buffer_limit_s
    model = Model(rate, state.request_latency_s, limit_s, np.linspace(0.0, limit_s, GRID_POINTS))
    segments = _horizon(state)
    value = _value_after(state, model, segments, value_before)
    rungs = np.array([p.index for p in state.options])
    sizes = np.array([p.size_bytes for p in state.options])
    quality = np.array([p.quality for p in state.options])
    download_s = model.download_s(sizes)
    change = 0.0 if state.shown_quality is None else np.abs(quality - state.shown_quality)
    stall = np.maximum(download_s - state.buffer_s, 0)
    left = np.minimum(np.maximum(state.buffer_s - download_s, 0) + state.segment_s, limit_s)
    after = np.array([np.interp(b, model.grid_s, value[r]) for b, r in zip(left, rungs, strict=True)])
    low = LOW_BUFFER_DB * np.maximum(RESERVE_S - left, 0)
    total = state.segment_s * (quality - SWITCH_DB * change - low) - STALL_DB * stall + after
    best = int(np.lexsort((sizes, -total))[0])
    reason = f"{rate / 1e6:.2f} Mbit/s, buffer {state.buffer_s:.2f} s, {len(segments)} segments ahead"
    return Decision(int(rungs[best]), bool(stall[best] <= 0), reason, int(sizes[best]))


def _horizon(state: PlayerState) -> list[Coming]:
    segments: list[Coming] = []
    total_s = 0.0
    for offer, known in islice(state.upcoming(), HORIZON_SEGMENTS):
        if segments and total_s >= HORIZON_S:
            break
        segments.append((offer, known))
        total_s += offer.seconds
    return segments


def _value_after(
    state: PlayerState, model: Model, segments: list[Coming], value_before: ValueBefore
) -> NDArray[np.float64]:
    """(R, B) best total of what follows the next segment, by its rung and the buffer that it leaves."""
    value = np.zeros((len(state.offer.rungs), GRID_POINTS))
    for (before, _), (offer, known) in reversed(list(pairwise(segments))):
        sizes = offer.bytes_after(before, known)
        value = value_before(model, sizes, offer.psnr, before.psnr, offer.seconds, value)
    return value
