"""Simulated sessions against the same player over real HTTP on loopback, shaped by the same trace.

A relay in front of `airgs-serve` holds requests back for a round trip, and passes no byte of its answers earlier than
the trace lets it. The player runs against it by the real clock, then over the simulated link with the
same settings; neither pipelines batches. Arrivals are compared as long as both asked for the same.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from airgs_codec.package.package import open_package
from airgs_codec.play.http import HttpDownloader
from airgs_codec.play.offers import Offers
from airgs_codec.play.playout import SessionSettings
from airgs_codec.play.session import SessionLog, play, simulate
from airgs_codec.play.trace import Link, Trace
from tools.lab import Lab, Page, Row, Section, Table, required, setting
from tools.lab.relay import shaped
from tools.lab.serving import airgs_serve


@dataclass(frozen=True, slots=True)
class Options:
    package: Path = required("a package")
    traces: tuple[str, ...] = required("traces, as airgs-play takes them")
    seconds: float = setting(20.0, "of play")
    policy: str = setting("robust-mpc", "a policy of airgs-play")


def run(options: Options, lab: Lab) -> Page:
    offers = Offers.of(open_package(options.package))
    rows = [row_of(options, offers, trace) for trace in options.traces]
    most = max(row["arrivals off, mean"] for row in rows)
    answer = f"Arrivals are {100 * most:.1f} % off on average over the worst trace."
    return Page([Section(answer, tables=[Table("link", rows)])])


def row_of(options: Options, offers: Offers, trace: str) -> Row:
    loops = max(1, round(options.seconds / offers.duration_s))
    settings = SessionSettings(loops=loops, pipelined=False)
    link = Link.over(Trace.open(trace))
    with airgs_serve(options.package) as (_, url), shaped(int(url.rpartition(":")[2]), link.trace, link.rtt_s) as port:
        real = play_really(f"http://127.0.0.1:{port}/{options.package.resolve().name}/", options.policy, settings)
    simulated = simulate(offers, link, options.policy, settings)
    same, mean, worst = compare(real, simulated)
    return {
        "trace": Path(trace).name, "same batches": same, "of": len(simulated.fetches),
        "arrivals off, mean": mean, "worst": worst,
        "PSNR, dB": real.metrics.psnr_mean, "simulated, dB": simulated.metrics.psnr_mean,
        "stalled, s": real.metrics.stall_s, "simulated, s": simulated.metrics.stall_s,
    }  # fmt: skip


def play_really(url: str, policy: str, settings: SessionSettings) -> SessionLog:
    with HttpDownloader(url) as downloader:
        return play(downloader.open(), downloader, policy, settings)


def compare(real: SessionLog, simulated: SessionLog) -> tuple[int, float, float]:
    """Batches until the two asked for something different, and mean and worst relative error of their arrivals."""
    pairs = list(zip(real.fetches, simulated.fetches, strict=False))
    same = next((i for i, (a, b) in enumerate(pairs) if (a.position, a.rung) != (b.position, b.rung)), len(pairs))
    errors = [abs(a.arrival_s - b.arrival_s) / b.arrival_s for a, b in pairs[:same]]
    return same, float(np.mean(errors)), max(errors)
