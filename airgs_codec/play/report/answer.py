"""What a session comes to, in whole sentences: how good it was, what went wrong and why, what would help."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from airgs_codec._report import listed
from airgs_codec.package.manifest import on_ladder, pooled_quality
from airgs_codec.play.fetcher import SHORTEST_S
from airgs_codec.play.policies.named import DEFAULT_POLICY
from airgs_codec.play.report.map import Viewer
from airgs_codec.play.session import SessionLog, session_bound

LOOK = "Look at the files: airgs-manifest validate names those that are broken."
MUCH_DB = 0.5  # under the bound from which another policy may be worth a look
MUCH_WAIT = 0.1  # of the waiting
MUCH_WASTE = 0.05  # of the bytes
OFTEN = 0.9  # share of the segments in the top rung, and of the link, from which more or nothing is to be had
REASONS = FAULTS, BELOW, OVER, ASKED, SHORT = (  # why a viewer waited
    "files had to be asked for again",
    "the link gave less than the lowest rung needs",
    "less came than was expected",
    "the policy asked for more than the link gave",
    "too little was buffered for what came next",
)


def rung_record(log: SessionLog) -> list[dict[str, Any]]:
    """Every rung with its rate, the quality that the package claims for it (None where it was not measured), and how
    many segments showed it.
    """
    m, names = log.offers.manifest, log.offers.names
    qualities = [pooled_quality(m, level, quality) for quality, level in log.offers.rungs]
    rates = [8 * m.bytes_of(m.rung_files(*rung)) / log.offers.duration_s for rung in log.offers.rungs]
    best = on_ladder([(rate, q.psnr if q else None) for rate, q in zip(rates, qualities, strict=True)])
    return [
        {"rung": name, "psnr": q.psnr if q else None, "worst": q.worst if q else None}
        | {"mbps": rate / 1e6, "on_ladder": on, "shown": log.metrics.rungs.get(name, 0)}
        for name, q, rate, on in zip(names, qualities, rates, best, strict=True)
    ]


def lowest_mbps(log: SessionLog) -> float:
    """The rate of the smallest rung, without headers."""
    return min(float(rung["mbps"]) for rung in rung_record(log))


class Stall(NamedTuple):
    """A wait after the first picture."""

    at_s: float
    seconds: float
    why: str  # of REASONS
    came_bps: float  # between the first request of what was waited for and its arrival


def find_stalls(log: SessionLog) -> list[Stall]:
    """Every wait after the first picture with its reason, the first of REASONS that holds."""
    rungs, lowest, stalls = rung_record(log), lowest_mbps(log), []
    for position, shown in enumerate(log.shown):
        if shown.stall_s <= SHORTEST_S:
            continue
        batches = [f for f in log.fetches if f.position == position and f.request_s < shown.ready_s]
        begun_s = min((f.request_s for f in batches), default=shown.ready_s)
        came = log.link.bytes_between(begun_s, shown.ready_s) if log.link else sum(f.bytes for f in batches)
        came_bps = 8 * came / max(shown.ready_s - begun_s, SHORTEST_S)
        expected_bps = max((f.throughput_bps for f in batches), default=0.0)
        reasons = {
            FAULTS: shown.rung is None or any(f.retries for f in batches),
            BELOW: came_bps < 1e6 * lowest,
            OVER: came_bps < expected_bps / 1.2,
            ASKED: came_bps < 1e6 * rungs[shown.rung or 0]["mbps"],
        }
        why = next((reason for reason, holds in reasons.items() if holds), SHORT)
        stalls.append(Stall(shown.start_s - shown.stall_s, shown.stall_s, why, came_bps))
    return stalls


def answer(log: SessionLog, viewer: Viewer | None = None) -> dict[str, str]:
    """What a session comes to in whole sentences, by what they tell."""
    stalls = find_stalls(log)
    return {
        "good": _good(log),
        "wrong": " ".join(_wrong(log, stalls, viewer)) or "Nothing: the viewer never waited after the first picture.",
        "useless": _useless(rung_record(log)),
        "change": " ".join(_advice(log, stalls)) or "Nothing.",
    }


def _good(log: SessionLog) -> str:
    r, start = log.metrics, f"The first picture came after {log.metrics.startup_s:.1f} s."
    if r.psnr_mean is None:
        return f"The package was not measured: how good its pictures are is not known. {start}"
    seen = [p for p in (log.shown[i].psnr for i, _ in log.screen_ticks) if p is not None]
    worst = np.mean(np.sort(seen)[: max(1, len(seen) // 10)])
    bound = session_bound(log) if log.offers.manifest.measured else None
    most = "" if bound is None else f" No player could have shown more than {bound:.1f} dB at the same moments."
    return f"The screen showed {r.psnr_mean:.1f} dB on average, {worst:.1f} in its worst tenth.{most} {start}"


def _wrong(log: SessionLog, stalls: Sequence[Stall], viewer: Viewer | None) -> list[str]:
    r, told = log.metrics, []
    if stalls:
        share, first_s = f"{100 * r.stall_ratio:.1f} % of the time", stalls[0].at_s
        told.append(f"The viewer waited for {r.stall_s:.1f} s, {share}, first {first_s:.1f} s after the first request.")
    for why in REASONS:
        some = [stall for stall in stalls if stall.why == why]
        if some:
            least, count = min(stall.came_bps for stall in some) / 1e6, f"{len(some)} of {len(stalls)} waits"
            told.append(f"{count} ({sum(s.seconds for s in some):.1f} s): {why}, {least:.2f} Mbit/s at the least.")
    if log.lost:
        told.append(f"{r.lost_frames} frames were lost.")
    if r.wasted > MUCH_WASTE:
        told.append(f"{100 * r.wasted:.0f} % of the bytes served nothing.")
    if viewer is not None and viewer.outside:
        told.append(f"The viewer was {viewer.words}: there the package promises nothing.")
    return told


def _useless(rungs: Sequence[Mapping[str, Any]]) -> str:
    """Which rungs no player should fetch, and which this link did not ask for."""
    good = {r["rung"]: r["on_ladder"] for r in rungs if r["psnr"] is not None}
    unseen = [r["rung"] for r in rungs if good.get(r["rung"], True) and not r["shown"]]
    told = [beaten_words(good), f"Not shown on this link: {listed(unseen)}." if unseen else ""]
    return " ".join(filter(None, told)) or "Nothing: every rung was shown."


def beaten_words(on_ladder: Mapping[str, bool]) -> str:
    """Which rungs no player should fetch, of those that were measured, and what of them only takes room.

    `on_ladder`: of rungs by names such as Q1+L2. Empty where all are worth their bytes.
    """
    beaten = [name for name, on in on_ladder.items() if not on]
    if not beaten:
        return ""
    used = {part for name, on in on_ladder.items() if on for part in name.split("+")}
    idle = sorted({part for name in beaten for part in name.split("+")} - used)
    room = f"{listed(idle)} could be left out of the package" if idle else "their keys and states are parts of others"
    return f"No player should fetch {listed(beaten)}: others show more for the same bytes; {room}."


def _advice(log: SessionLog, stalls: Sequence[Stall]) -> list[str]:
    """What would help most against each kind of long waits; where there are none, what would show more."""
    if stalls:
        return _against(log, stalls)
    r, told = log.metrics, [LOOK] * bool(log.lost)
    bound = session_bound(log) if log.offers.manifest.measured else None
    if bound is not None and bound - log.mean_quality > MUCH_DB:
        told.append(f"Another policy may show up to {bound - log.mean_quality:.1f} dB more: --compare tells which.")
    if r.rungs.get(log.offers.names[0], 0) > OFTEN * len(log.shown) and (r.utilisation or 1.0) < OFTEN:
        told.append("The link carries more than the top rung: airgs-encode --quality high has finer ones.")
    return told


def _against(log: SessionLog, stalls: Sequence[Stall]) -> list[str]:
    """What would help against waits, the longest kind first; kinds of under MUCH_WAIT of the waiting are left out."""
    waits = {why: sum(s.seconds for s in stalls if s.why == why) for why in REASONS}
    buffer = f"--player.buffer {2 * log.settings.buffer_s:g}"
    policy = buffer if log.policy == DEFAULT_POLICY else f"--policy {DEFAULT_POLICY}"
    came = min((s.came_bps for s in stalls if s.why == BELOW), default=0.0) / 1e6
    startup_s = log.settings.startup_s + waits[SHORT] + 0.05  # rounded up
    end_s = max(f.arrival_s for f in log.fetches)
    carried = log.link.bytes_between(0.0, end_s) if log.link else log.metrics.wire_bytes
    bridge = f", or buffer more before ({buffer})" if 8e-6 * carried / end_s > lowest_mbps(log) else ""
    helps = {
        FAULTS: LOOK,
        BELOW: f"No policy helps there: encode a lower level (airgs-encode --levels) that {came:.2f} Mbit/s carry"
        f"{bridge}.",
        OVER: f"Be more cautious: {policy}.",
        ASKED: f"Ask for less: {policy}.",
        SHORT: f"Buffer longer before playing: --player.startup {startup_s:.1f}.",
    }
    long = [why for why in REASONS if waits[why] >= MUCH_WAIT * sum(waits.values())]
    long.sort(key=lambda why: -waits[why])
    if OVER in long and ASKED in long:  # the same setting helps against both
        long.remove(min(OVER, ASKED, key=lambda why: waits[why]))
    return [helps[why] for why in long]
