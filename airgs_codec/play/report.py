"""What a session was like: how good it was, what went wrong, what would help; its figures as text, and a page."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from airgs_codec._report import BLUE, GREEN, GREY, RED, Page, Picture, html_table, listed, report_folder
from airgs_codec.package.manifest import on_ladder, pooled_quality
from airgs_codec.package.region import RegionSummary
from airgs_codec.places.whole import write_json
from airgs_codec.play.fetcher import SHORTEST_S
from airgs_codec.play.metrics import FIGURES, SessionMetrics
from airgs_codec.play.policies import DEFAULT_POLICY
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
MOST_LINES = 10  # of what went wrong
LEAST_DB = 2.0  # of an axis: less is not seen


def write_report(log: SessionLog, directory: Path) -> Path:
    """Write index.html and session.json into `directory`; gives the page. Raises ConfigError."""
    with report_folder(directory):
        record = {
            "metrics": log.metrics.as_dict(),
            "answer": answer(log),
            "region": region_record(log),
            "rungs": rung_record(log),
            "meanings": FIGURES,
            "fetches": [dataclasses.asdict(f) for f in log.fetches],
            "shown": [dataclasses.asdict(s) for s in log.shown],
        }
        write_json(directory / "session.json", record)
        page = Page(f"A session of {log.policy}", answer(log), _pictures(log), _more(log))
        return page.write(directory / "index.html")


def region_record(log: SessionLog) -> dict[str, Any]:
    return dataclasses.asdict(RegionSummary.of(log.offers.manifest.region))


def _pictures(log: SessionLog) -> list[Picture]:
    rates = "The link and what was asked of it; red: the viewer waits."
    shown = "PSNR on the screen over time; red: the viewer waits."
    return [Picture(rates, partial(_rates, log)), Picture(shown, partial(_psnr, log))]


def _over_time(axis: Any, log: SessionLog, name: str) -> None:
    for s in log.shown:
        if s.stall_s > SHORTEST_S:
            axis.axvspan(s.start_s - s.stall_s, s.start_s, color=RED, alpha=0.2, linewidth=0)
    axis.set(xlabel="seconds since the first request", ylabel=name, xlim=(0, _end(log)))


def _end(log: SessionLog) -> float:
    last = log.shown[-1]
    return last.start_s + last.frames / log.offers.fps


def _rates(log: SessionLog, axis: Any) -> None:
    if log.link is not None:
        grid = np.linspace(0, _end(log), 1500)
        rates = [log.link.trace.rate_at(t) / 1e6 for t in grid]
        axis.fill_between(grid, rates, color=BLUE, alpha=0.25, linewidth=0, label="link")
    axis.step(
        [f.request_s for f in log.fetches], [f.throughput_bps / 1e6 for f in log.fetches], where="post", color=BLUE
    )
    axis.lines[-1].set_label("expected")
    rungs = rung_record(log)
    times_s = [s.start_s for s in log.shown if s.rung is not None]
    shown = [rungs[s.rung]["mbps"] for s in log.shown if s.rung is not None]
    axis.step(times_s, shown, where="post", color=GREEN, label="shown")
    axis.axhline(min(rung["mbps"] for rung in rungs), color=GREY, linestyle="--", label="lowest rung")
    _over_time(axis, log, "Mbit/s")
    axis.set_ylim(0, 1.3 * axis.get_ylim()[1])  # room for the legend
    axis.legend(ncols=4, loc="upper center", fontsize=8, handlelength=1, columnspacing=1, frameon=False)


def _psnr(log: SessionLog, axis: Any) -> None:
    values = [log.shown[i].psnr for i, _ in log.screen_ticks]
    if all(v is None for v in values):
        axis.text(0.5, 0.5, "quality was not measured", ha="center", transform=axis.transAxes)
    else:
        at_s = log.shown[0].start_s + np.arange(len(values)) / log.offers.fps
        axis.step(at_s, np.array(values, np.float64), where="post", color=BLUE)
        low, high = axis.get_ylim()
        axis.set_ylim(min(low, high - LEAST_DB), high)
    _over_time(axis, log, "dB")


def format_metrics(log: SessionLog) -> str:
    return "\n".join(f"{name:<22}{value}" for name, value in _readable(log))


def _readable(log: SessionLog) -> list[tuple[str, str]]:
    r: dict[str, Any] = log.metrics.as_dict()
    bound = session_bound(log) if log.offers.manifest.measured else None
    quality = "not measured"
    if r["psnr_mean"] is not None:
        quality = f"mean over ticks {r['psnr_mean']:.2f} dB, 5th percentile {r['psnr_p5']:.2f} dB"
    wire = ", ".join(f"{kind} {size / 1e3:.1f}" for kind, size in r["bytes"].items())
    used = "" if r["utilisation"] is None else f", {100 * r['utilisation']:.0f} % of what could pass"
    rows = [
        ("policy", log.policy),
        ("trace", _trace_words(log.metrics)),
        ("played", f"{r['frames']} frames, {r['played_s']:.2f} s"),
        ("start-up", _startup_words(log.metrics)),
        ("stalls", f"{r['stalls']}, {r['stall_s']:.3f} s, {100 * r['stall_ratio']:.2f} %"),
        ("PSNR on screen", quality),
        ("rungs", ", ".join(f"{name} x{count}" for name, count in r["rungs"].items())),
        ("Gaussians", _gaussian_words(log)),
        ("switches", f"{r['switches']}, mean change {r['change_db']:.2f} dB"),
        ("fetched, kB", f"{wire}; {r['bytes_per_frame'] / 1e3:.2f} a frame"),
        ("wire", f"{r['wire_bytes'] / 1e3:.1f} kB with headers" + used),
        ("wasted", f"{100 * r['wasted']:.1f} %: {r['replaced']} replacements, {r['abandoned']} abandoned"),
    ]
    if r["delta_e_mean"] is not None:
        rows.append(("ΔE on screen", f"mean {r['delta_e_mean']:.2f} (CIEDE2000; about 1 is just noticeable)"))
    if r["qoe"] is not None:
        rows.append(("QoE", f"{r['qoe']:.2f} dB: quality - changes - 20 dB for a second of waiting"))
    if bound is not None:
        regret = f"regret {bound - log.mean_quality:.2f} dB"
        rows.append(("best possible", f"at most {bound:.2f} dB at the same moments, mean of segments: {regret}"))
    if log.lost:
        rows.append(("lost", f"{r['lost_frames']} frames; {some(log.lost)}"))
    if log.retried:
        rows.append(("asked for again", f"{len(log.retried)} files; {some(log.retried)}"))
    region = RegionSummary.of(log.offers.manifest.region)
    return [*rows, ("viewing region", region.words), ("views", region.views)]


def _gaussian_words(log: SessionLog) -> str:
    budget = log.settings.budget
    return f"at most {log.metrics.gaussians:,}" + ("" if budget is None else f" of a budget of {budget:,}")


def some(lines: Sequence[str]) -> str:
    """The first of some lines, and how many more there are."""
    more = len(lines) - MOST_LINES
    return "; ".join(lines[:MOST_LINES]) + (f"; and {more} more" if more > 0 else "")


def _trace_words(m: SessionMetrics) -> str:
    if m.trace is None or m.trace_mean_bps is None:
        return "none: a real connection"
    notes = [f"from {m.trace_offset_s:g} s"] * bool(m.trace_offset_s)
    notes += [f"rates x{m.trace_scale:g}"] * (m.trace_scale != 1)
    notes += [{"loop": "repeated", "hold": "last rate held", "error": ""}[m.trace_end or "loop"]] * bool(m.trace_ended)
    return ", ".join([f"{m.trace}, mean {m.trace_mean_bps / 1e6:.2f} Mbit/s", *notes])


def _startup_words(m: SessionMetrics) -> str:
    tables = f"{m.startup_table_bytes / 1e3:.1f} of them tables"
    return f"{m.startup_s:.3f} s: {m.startup_requests} requests, {m.startup_bytes / 1e3:.1f} kB, {tables}"


def _more(log: SessionLog) -> dict[str, str]:
    """All figures, and what the package says of its rungs, as HTML."""
    rungs = [
        (
            r["rung"],
            *("-" if r[name] is None else f"{r[name]:.2f} dB" for name in ("psnr", "worst")),
            f"{r['mbps']:.2f}",
            str(r["shown"]),
            "-" if r["psnr"] is None else "yes" if r["on_ladder"] else "no",
        )
        for r in rung_record(log)
    ]
    head = ("rung, best first", "PSNR", "worst picture", "Mbit/s", "segments shown", "worth its bytes")
    return {
        "All figures": html_table(_readable(log)),
        "What the package claims of its rungs": html_table(rungs, head),
    }


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


def answer(log: SessionLog) -> dict[str, str]:
    """What a session comes to in whole sentences, by what they tell."""
    stalls = find_stalls(log)
    return {
        "good": _good(log),
        "wrong": " ".join(_wrong(log, stalls)) or "Nothing: the viewer never waited after the first picture.",
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


def _wrong(log: SessionLog, stalls: Sequence[Stall]) -> list[str]:
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
