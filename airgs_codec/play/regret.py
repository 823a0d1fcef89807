"""How far a session was from the best that any player could have shown at the same moments."""

from __future__ import annotations

import numpy as np

from airgs_codec.play.bound import Horizon, Slot, solve_horizon
from airgs_codec.play.player import SHORTEST_S
from airgs_codec.play.session import SessionLog


def session_bound(log: SessionLog, integer: bool = False) -> float | None:
    """Upper bound on the mean PSNR (dB) of any player that shows each segment when this one did; see `bound`.

    None when segments were lost, where tiles were fetched by view, and over a real connection, whose capacity is not
    known.
    """
    link = log.link
    if link is None or log.tiles is not None or any(shown.rung is None for shown in log.shown):
        return None
    slots = []
    manifest_s = log.fetches[0].arrival_s
    c, limit = log.catalogue, log.settings.buffer_s
    fronts = np.cumsum([0.0, *(s.frames / c.fps for s in log.shown)])  # media time at which each begins
    for k, shown in enumerate(log.shown):
        release = manifest_s
        wanted = float(fronts[k + 1]) - limit  # media that must have been shown before the request
        if wanted > SHORTEST_S:  # not where rounding alone makes the buffer too small
            i = int(np.searchsorted(fronts, wanted - SHORTEST_S)) - 1  # before a stall, if one follows just there
            release = max(release, log.shown[i].start_s + wanted - float(fronts[i]))
        begin, deadline = release + link.rtt_s, shown.start_s - log.settings.decode_frame_s
        capacities = link.bytes_between(0.0, begin), link.bytes_between(0.0, deadline)
        slots.append(Slot(shown.segment, c.starts_group(shown.segment), *capacities))
    schedule = solve_horizon(Horizon(c, tuple(slots), {}), integer)
    return None if schedule is None else schedule.quality
