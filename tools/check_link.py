"""Simulated sessions against the same player over real HTTP on loopback, shaped by the same trace.

    python -m tools.check_link PACKAGE TRACE [TRACE ...] [--seconds S] [--policy NAME]

`airgs-serve --trace` in a process of its own holds requests back for a round trip, and writes no byte of its answers
earlier than the trace lets it pass. The player runs against it by the real clock, then over the simulated link with the
same settings; neither pipelines batches. Prints, for each trace, how far real arrivals were from the simulated ones, as
long as both asked for the same, and the figures of both sessions.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from airgs_codec.package.store import open_package
from airgs_codec.play.catalogue import Catalogue
from airgs_codec.play.http import HttpDownloader
from airgs_codec.play.link import Link
from airgs_codec.play.session import SessionLog, play, simulate
from airgs_codec.play.settings import SessionSettings
from airgs_codec.play.trace import open_trace

SERVE = "import sys; from airgs_codec.cli.serve import main; sys.exit(main())"


@contextmanager
def served(package: Path, trace: str) -> Iterator[str]:
    """The package behind a link that follows the trace from the first request on; gives its URL."""
    command = [sys.executable, "-c", SERVE, str(package), "--port", "0", "--trace", trace]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server:
        try:
            lines = server.stdout
            if lines is None:
                raise RuntimeError("the server's output is not there")
            lines.readline()
            yield lines.readline().strip()
        finally:
            server.terminate()


def play_really(url: str, policy: str, settings: SessionSettings) -> SessionLog:
    """A session over HTTP, by the clock."""
    with HttpDownloader(url) as downloader:
        return play(downloader.open(), downloader, policy, settings)


def compare(real: SessionLog, simulated: SessionLog) -> tuple[int, float, float]:
    """Batches until the two asked for something different, and mean and worst relative error of their arrivals."""
    pairs = list(zip(real.fetches, simulated.fetches, strict=False))
    same = next((i for i, (a, b) in enumerate(pairs) if (a.position, a.rung) != (b.position, b.rung)), len(pairs))
    errors = [abs(a.arrival_s - b.arrival_s) / b.arrival_s for a, b in pairs[:same]]
    return same, float(np.mean(errors)), max(errors)


def main() -> None:
    """Play, compare and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("package", type=Path)
    parser.add_argument("traces", nargs="+")
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--policy", default="robust-mpc")
    args = parser.parse_args()
    print(f"{'trace':<32}{'same batches':>14}{'arrival: mean':>15}{'worst':>9}{'PSNR, real / sim.':>26}{'stalled':>18}")
    catalogue = Catalogue.of(open_package(args.package))
    for name in args.traces:
        loops = max(1, round(args.seconds / catalogue.duration_s))
        settings = SessionSettings(loops=loops, pipelined=False)
        with served(args.package, name) as url:
            real = play_really(url, args.policy, settings)
        simulated = simulate(catalogue, Link.over(open_trace(name)), args.policy, settings)
        same, mean, worst = compare(real, simulated)
        batches = f"{same} of {len(simulated.fetches)}"
        quality = f"{real.metrics.psnr_mean or 0:.2f} / {simulated.metrics.psnr_mean or 0:.2f} dB"
        stalls = f"{real.metrics.stall_s:.2f} / {simulated.metrics.stall_s:.2f} s"
        print(f"{Path(name).name:<32}{batches:>14}{100 * mean:13.2f} %{100 * worst:7.2f} %{quality:>26}{stalls:>18}")


if __name__ == "__main__":
    main()
