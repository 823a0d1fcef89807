"""The policies of viewers: those of `airgs_codec.play`, of which `robust-mpc` has a compiled step.

The step is the same arithmetic in the same order, so that every choice is the same to the bit; a choice takes about a
tenth of the time. P rungs of the segment before, R rungs, B points of the buffer's grid.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
from numba import njit
from numpy.typing import NDArray

from airgs_codec.errors import ConfigError
from airgs_codec.play.offers import Offers
from airgs_codec.play.policies.mpc import GRID_POINTS, LOW_BUFFER_DB, SWITCH_DB, Model, choose_robust_mpc
from airgs_codec.play.policies.named import ORACLES, make_policy
from airgs_codec.play.policies.state import RESERVE_S, STALL_DB, Policy


@njit(cache=True)  # type: ignore[misc, unused-ignore]
def _best_totals(
    sizes: NDArray[np.int64],
    quality: NDArray[np.float64],
    quality_before: NDArray[np.float64],
    seconds: float,
    value: NDArray[np.float64],
    grid_s: NDArray[np.float64],
    limit_s: float,
    rate_bps: float,
    latency_s: float,
) -> NDArray[np.float64]:
    """(R, B); sizes (P, R), P = R or 1; see `Model.value_before`."""
    rungs, points = value.shape
    rows = sizes.shape[0]
    best = np.full((len(quality_before), points), -np.inf)
    total = np.empty((rows, points))
    source = np.zeros(len(quality_before), np.int64)
    for r in range(rungs):
        for p in range(rows):
            source[p] = p
            for earlier in range(p):
                if sizes[earlier, r] == sizes[p, r]:
                    source[p] = earlier
                    break
            if source[p] != p:
                continue
            download_s = latency_s * (1.0 if sizes[p, r] > 0 else 0.0) + 8 * sizes[p, r] / rate_bps
            for b in range(points):
                buffer = grid_s[b] - download_s
                left = min(max(buffer, 0.0) + seconds, limit_s)
                place = left * ((points - 1) / limit_s)
                at = min(int(place), points - 2)
                part = place - at
                sum_db = seconds * quality[r] + STALL_DB * min(buffer, 0.0)
                sum_db = sum_db - seconds * LOW_BUFFER_DB * max(RESERVE_S - left, 0.0)
                total[p, b] = sum_db + value[r, at] * (1 - part) + value[r, at + 1] * part
        for p in range(len(quality_before)):
            row = source[p] if rows > 1 else 0
            change = seconds * SWITCH_DB * abs(quality[r] - quality_before[p])
            for b in range(points):
                best[p, b] = max(best[p, b], total[row, b] - change)
    return best


def value_before(
    model: Model,
    sizes: NDArray[np.int64],
    quality: NDArray[np.float64],
    quality_before: NDArray[np.float64],
    seconds: float,
    value: NDArray[np.float64],
) -> NDArray[np.float64]:
    """(R, B) the same as `Model.value_before`."""
    assert len(model.grid_s) == GRID_POINTS
    link = model.grid_s, model.limit_s, model.rate_bps, model.latency_s
    return np.asarray(_best_totals(sizes, quality, quality_before, seconds, value, *link))


def crowd_policy(name: str, offers: Offers) -> Policy:
    """A policy by name. Raises ConfigError for an unknown one, and for the oracles: no viewer knows the shared link."""
    if name in ORACLES:
        raise ConfigError(f"policy {name}: it knows one trace in advance, and here viewers share a link")
    policy = make_policy(name, offers)
    if policy.choose is not choose_robust_mpc:
        return policy
    return replace(policy, choose=partial(choose_robust_mpc, value_before=value_before))
