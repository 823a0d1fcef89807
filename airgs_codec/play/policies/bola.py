"""BOLA-BASIC: Lyapunov optimisation of the buffer (Spiteri et al., INFOCOM 2016).

Utilities come from measured quality, sizes are those of each segment.
"""

from __future__ import annotations

import math

import numpy as np

from airgs_codec.play.ladder import Decision
from airgs_codec.play.policies.state import RESERVE_S, PlayerState, full_ladder


def choose_bola(state: PlayerState) -> Decision:
    """The rung with the largest (V (u + g) - Q) / size.

    u is quality in nepers above the smallest rung, Q the buffer in seconds. V and g are such that the smallest rung is
    left at RESERVE_S (a third of a smaller buffer) and the best one scores nothing when the buffer is full.
    """
    rungs = full_ladder(state).options
    if len(rungs) == 1:
        return Decision(rungs[0].index, True, "one rung", rungs[0].size_bytes)
    utility = [(p.quality - rungs[-1].quality) * math.log(10) / 20 for p in rungs]
    smallest = rungs[-1].size_bytes
    limit = max(state.buffer_limit_s - state.segment_s, state.segment_s)
    reserve = min(RESERVE_S, limit / 3)
    bend = max(u * smallest / (p.size_bytes - smallest) for u, p in zip(utility, rungs[:-1], strict=False))
    v = (limit - reserve) / (utility[0] + bend)
    g = bend + reserve / v
    scores = [(v * (u + g) - state.buffer_s) / max(1, p.size_bytes) for u, p in zip(utility, rungs, strict=True)]
    chosen = rungs[0 if max(scores) <= 0 else int(np.argmax(scores))]
    return Decision(chosen.index, True, f"buffer {state.buffer_s:.2f} s", chosen.size_bytes)
