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
from tools.lab.made import encoded
from tools.lab.relay import shaped
from tools.lab.serving import airgs_serve

COLUMNS = {
    "trace": ("trace", ""), "same": ("same requests", ""), "of": ("of", ""), "off": ("arrivals off by, mean", ".1%"),
    "psnr": ("PSNR over HTTP, dB", ".2f"), "simulated_psnr": ("simulated", ".2f"),
    "stalled": ("waiting over HTTP, s", ".2f"), "simulated_stalled": ("simulated", ".2f"),
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Options:
    scene: str = required("a scene or a package, SCENE[=VIEWS]")
    traces: tuple[str, ...] = required("traces, as airgs-play takes them")
    seconds: float = setting(20.0, "of play")
    policy: str = setting("robust-mpc", "a policy of airgs-play")


def run(options: Options, lab: Lab) -> Page:
    package = encoded(options.scene, lab.folder)
    return Page(
        [Section("", tables=[Table("link", [row_of(options, package, trace) for trace in options.traces], COLUMNS)])]
    )


def row_of(options: Options, package: Path, trace: str) -> Row:
    offers = Offers.of(open_package(package))
    loops = max(1, round(options.seconds / offers.duration_s))
    settings = SessionSettings(loops=loops, pipelined=False)
    link = Link.over(Trace.open(trace))
    with airgs_serve(package) as (_, url), shaped(int(url.rpartition(":")[2]), link.trace, link.rtt_s) as port:
        real = play_really(f"http://127.0.0.1:{port}/{package.resolve().name}/", options.policy, settings)
    simulated = simulate(offers, link, options.policy, settings)
    same, mean, most = compare(real, simulated)
    return {
        "trace": Path(trace).name, "same": same, "of": len(simulated.fetches), "off": mean, "most": most,
        "psnr": real.metrics.psnr_mean, "simulated_psnr": simulated.metrics.psnr_mean,
        "stalled": real.metrics.stall_s, "simulated_stalled": simulated.metrics.stall_s,
    }  # fmt: skip


def play_really(url: str, policy: str, settings: SessionSettings) -> SessionLog:
    with HttpDownloader(url) as downloader:
        return play(downloader.open(), downloader, policy, settings)


def compare(real: SessionLog, simulated: SessionLog) -> tuple[int, float, float]:
    """Batches until the two asked for something different, and mean and most relative error of their arrivals."""
    pairs = list(zip(real.fetches, simulated.fetches, strict=False))
    same = next((i for i, (a, b) in enumerate(pairs) if (a.position, a.rung) != (b.position, b.rung)), len(pairs))
    errors = [abs(a.arrival_s - b.arrival_s) / b.arrival_s for a, b in pairs[:same]]
    return same, float(np.mean(errors)), max(errors)
