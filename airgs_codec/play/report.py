"""What a session was like: how good it was, what went wrong, what would help; its figures as text, and a page."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from airgs_codec._report import BLUE, GREEN, GREY, RED, Page, PagePicture, Table, answered, cell, listed
from airgs_codec.package.manifest import quality_of, rungs_of
from airgs_codec.package.region import region_words
from airgs_codec.play.metrics import QOE_WORDS
from airgs_codec.play.player import SHORTEST_S
from airgs_codec.play.policies import DEFAULT_POLICY
from airgs_codec.play.session import SessionLog, session_bound

LOOK = "Look at the files: airgs-manifest validate names those that are broken."
MUCH_DB = 0.5  # under the bound from which another policy may be worth a look
MUCH_WAIT = 0.1  # of the waiting
MUCH_WASTE = 0.05  # of the bytes
OFTEN = 0.9  # share of the segments in the top rung, and of the link, from which more or nothing is to be had
FAULTS, BELOW, ASKED, SHORTAGE = (  # why a viewer waited
    "files had to be asked for again",
    "the link gave less than the lowest rung needs",
    "the policy asked for more than the link gave",
    "too little was buffered for what came next",
)
RUNGS = {
    "rung": ("rung, best first", ""), "psnr": ("PSNR, dB", ".2f"), "low": ("worst 5 %", ".1f"),
    "mbps": ("Mbit/s", ".2f"), "shown": ("segments shown", "d"), "on_ladder": ("worth its bytes", ""),
}  # fmt: skip


def write_report(log: SessionLog, directory: Path) -> Path:
    """Write index.html into `directory`, and give its path. Raises ConfigError."""
    words = "The link and what was asked of it, PSNR on the screen; red: the viewer waits."
    pictures = [PagePicture("", words, partial(_draw, log), (5.5, 3.8))]
    figures = [{"figure": name, "value": value} for name, value in _readable(log).items()]
    tables = Table("All figures", figures), Table("What the package claims of its rungs", rung_record(log), RUNGS)
    return Page(answered(answer(log), pictures, *tables), f"A session of {log.policy}").write(directory)


def _draw(log: SessionLog, figure: Any) -> None:
    rates, quality = figure.subplots(2, 1, sharex=True)
    last, rungs, fps = log.shown[-1], rung_record(log), log.offers.fps
    end_s = last.start_s + last.frames / fps
    if log.link is not None:
        grid = np.linspace(0, end_s, 1500)
        link = [log.link.trace.rate_at(t) / 1e6 for t in grid]
        rates.fill_between(grid, link, color=BLUE, alpha=0.25, linewidth=0, label="link")
    expected = [f.throughput_bps / 1e6 for f in log.fetches]
    rates.step([f.request_s for f in log.fetches], expected, where="post", color=BLUE, label="expected")
    shown = [(s.start_s, rungs[s.rung]["mbps"]) for s in log.shown if s.rung is not None]
    rates.step([at for at, _ in shown], [rate for _, rate in shown], where="post", color=GREEN, label="shown")
    rates.axhline(min(rung["mbps"] for rung in rungs), color=GREY, linestyle="--", label="lowest rung")
    rates.set_ylim(0, 1.3 * rates.get_ylim()[1])  # room for the legend
    rates.legend(ncols=4, loc="upper center", frameon=False)
    psnr = np.array([log.shown[i].psnr for i, _ in log.screen_ticks], np.float64)  # NaN where it was not measured
    quality.step(log.shown[0].start_s + np.arange(len(psnr)) / fps, psnr, where="post", color=BLUE)
    quality.set(xlabel="seconds since the first request", xlim=(0, end_s), ylabel="PSNR, dB")
    rates.set(ylabel="Mbit/s")
    for s in log.shown:
        if s.stall_s > SHORTEST_S:
            for axis in (rates, quality):
                axis.axvspan(s.start_s - s.stall_s, s.start_s, color=RED, alpha=0.2, linewidth=0)


def format_metrics(log: SessionLog) -> str:
    return "\n".join(f"{name:<22}{value}" for name, value in _readable(log).items())


def _readable(log: SessionLog) -> dict[str, str]:
    m, budget = log.metrics, log.settings.budget
    bound, link = session_bound(log), log.link
    quality = f"mean over ticks {m.psnr_mean:.2f} dB, 5th percentile {m.psnr_p5:.2f} dB" if m.psnr_mean else ""
    used = "" if m.utilisation is None else f", {100 * m.utilisation:.0f} % of what could pass"
    fetched = ", ".join(f"{kind} {size / 1e3:.1f}" for kind, size in m.bytes.items())
    rows = {
        "policy": log.policy,
        "trace": f"{link.trace.name}, mean {link.trace.mean_bps / 1e6:.2f} Mbit/s" if link else "a real connection",
        "played": "a still: 1 frame" if log.offers.manifest.still else f"{m.frames} frames, {m.played_s:.2f} s",
        "first picture": f"{m.startup_s:.3f} s: {m.startup_requests} requests, {m.startup_bytes / 1e3:.1f} kB, "
        f"{m.startup_table_bytes / 1e3:.1f} of them tables",
        "a seek": cell(m.seek_s, "{:.3f} s to a picture of the rung that was shown, with nothing of its group".format),
        "stalls": f"{m.stalls}, {m.stall_s:.3f} s, {100 * m.stall_ratio:.2f} %",
        "PSNR on screen": quality or "not measured",
        "rungs": ", ".join(f"{name} x{count}" for name, count in m.rungs.items()),
        "Gaussians": f"at most {m.gaussians:,}" + ("" if budget is None else f" of a budget of {budget:,}"),
        "switches": f"{m.switches}, mean change {m.change_db:.2f} dB",
        "fetched, kB": f"{fetched}; {m.bytes_per_frame / 1e3:.2f} a frame, {m.bits_per_gaussian:.2f} bits a Gaussian",
        "wire": f"{m.wire_bytes / 1e3:.1f} kB with headers{used}",
        "wasted": f"{100 * m.wasted:.1f} %: {m.replaced} replacements, {m.abandoned} abandoned",
        "ΔE on screen": cell(m.delta_e_mean, "mean {:.2f} (CIEDE2000; about 1 is just noticeable)".format),
        "QoE": cell(m.qoe, f"{{:.2f}} dB: {QOE_WORDS}".format),
        "best possible": cell(bound, "at most {:.2f} dB at the same moments, mean of segments".format),
        "regret": "-" if bound is None else f"{bound - log.mean_quality:.2f} dB less than that",
        "lost": f"{m.lost_frames} frames; {listed(log.lost)}" if log.lost else "-",
        "asked for again": f"{len(log.retried)} files; {listed(log.retried)}" if log.retried else "-",
        "viewing region": region_words(log.offers.manifest.region),
    }
    return {name: value for name, value in rows.items() if value != "-"}


def rung_record(log: SessionLog) -> list[dict[str, Any]]:
    """Return every rung with its rate, claimed quality, None where not measured, and how many segments showed it."""
    m, record = log.offers.manifest, []
    for rung, (keyframe_quality, level) in zip(rungs_of(m, 0), log.offers.rungs, strict=True):
        claim, mbps = quality_of(m, level, keyframe_quality), 8e-6 * rung.bytes / log.offers.duration_s
        row = {"rung": rung.name, "psnr": rung.psnr, "low": claim.low if claim else None, "mbps": mbps}
        record.append(row | {"on_ladder": rung.best, "shown": log.metrics.rungs.get(rung.name, 0)})
    return record


def find_waits(log: SessionLog) -> dict[str, float]:
    """Return the seconds that the viewer waited after the first picture, by the first of four reasons that holds."""
    rungs, waits = rung_record(log), dict.fromkeys((FAULTS, BELOW, ASKED, SHORTAGE), 0.0)
    for position, segment in enumerate(log.shown):
        if segment.stall_s <= SHORTEST_S:
            continue
        batches = [f for f in log.fetches if f.position == position and f.request_s < segment.ready_s]
        begun_s = min((f.request_s for f in batches), default=segment.ready_s)
        came = log.link.bytes_between(begun_s, segment.ready_s) if log.link else sum(f.bytes for f in batches)
        came_mbps = 8e-6 * came / max(segment.ready_s - begun_s, SHORTEST_S)
        reasons = {
            FAULTS: segment.rung is None or any(f.retries for f in batches),
            BELOW: came_mbps < min(rung["mbps"] for rung in rungs),
            ASKED: came_mbps < rungs[segment.rung or 0]["mbps"],
            SHORTAGE: True,
        }
        waits[next(why for why in reasons if reasons[why])] += segment.stall_s
    return waits


def answer(log: SessionLog) -> dict[str, str]:
    """Return what a session shows in whole sentences, by the keyframes of HEADS."""
    m, waits, record, bound = log.metrics, find_waits(log), rung_record(log), session_bound(log)
    good, wrong = "The package was not measured: how good its pictures are is not known.", []
    if m.psnr_mean is not None:
        good = f"The screen showed {m.psnr_mean:.1f} dB on average, {m.psnr_p5:.1f} dB as its 5th percentile."
    if bound is not None:
        good += f" No player could have shown more than {bound:.1f} dB at the same moments."
    if m.stalls:
        why = "; ".join(f"{why} ({seconds:.1f} s)" for why, seconds in waits.items() if seconds)
        wrong.append(f"The viewer waited for {m.stall_s:.1f} s, {100 * m.stall_ratio:.1f} % of the time: {why}.")
    if log.lost:
        wrong.append(f"{m.lost_frames} frames were lost.")
    if m.wasted > MUCH_WASTE:
        wrong.append(f"{100 * m.wasted:.0f} % of the bytes served nothing.")
    worth = {r["rung"]: r["on_ladder"] for r in record if r["psnr"] is not None}
    unseen = [r["rung"] for r in record if worth.get(r["rung"], True) and not r["shown"]]
    useless = [beaten_words(worth), f"Not shown on this link: {listed(unseen)}." if unseen else ""]
    return {
        "good": f"{good} The first picture came after {m.startup_s:.1f} s.",
        "wrong": " ".join(wrong) or "Nothing: the viewer never waited after the first picture.",
        "useless": " ".join(filter(None, useless)) or "Nothing: every rung was shown.",
        "change": " ".join(_against(log, waits) if m.stalls else _to_show_more(log, bound)) or "Nothing.",
    }


def beaten_words(on_ladder: Mapping[str, bool]) -> str:
    """Return which of the rungs that were measured no player should fetch; empty where all are worth their bytes."""
    beaten = [name for name, on in on_ladder.items() if not on]
    return f"No player should fetch {listed(beaten)}: others show more for the same bytes." if beaten else ""


def _to_show_more(log: SessionLog, bound: float | None) -> list[str]:
    m, found = log.metrics, [LOOK] if log.lost else []
    if bound is not None and bound - log.mean_quality > MUCH_DB:
        found.append(f"Another policy may show up to {bound - log.mean_quality:.1f} dB more: --compare tells which.")
    if m.rungs.get(log.offers.names[0], 0) > OFTEN * len(log.shown) and (m.utilisation or 1.0) < OFTEN:
        found.append("The link carries more than the top rung: airgs-encode --quality high has finer ones.")
    return found


def _against(log: SessionLog, waits: Mapping[str, float]) -> list[str]:
    """Return what would help against waits, the longest kind first, without kinds under MUCH_WAIT of the waiting."""
    buffer = f"--player.buffer {2 * log.settings.buffer_s:g}"
    cautious = f"Be more cautious: {buffer if log.policy == DEFAULT_POLICY else f'--policy {DEFAULT_POLICY}'}."
    lowest_bps = 1e6 * min(rung["mbps"] for rung in rung_record(log))
    bridge = f", or buffer more before ({buffer})" if log.link and log.link.trace.mean_bps > lowest_bps else ""
    startup_s = log.settings.startup_s + waits[SHORTAGE] + 0.05  # rounded up
    helps = {
        FAULTS: LOOK,
        BELOW: f"No policy helps where so little comes: encode a lower level (airgs-encode --levels){bridge}.",
        ASKED: cautious,
        SHORTAGE: f"Buffer longer before playing: --player.startup {startup_s:.1f}.",
    }
    long = [why for why in sorted(waits, key=lambda why: -waits[why]) if waits[why] >= MUCH_WAIT * sum(waits.values())]
    return list(dict.fromkeys(helps[why] for why in long))
