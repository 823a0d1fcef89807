"""Simulated sessions against the same player over real HTTP on loopback, shaped by the same trace.

    python -m tools.check_link PACKAGE TRACE [TRACE ...] [--seconds S] [--policy NAME]

A server holds the answers of a batch back until a round trip after its requests and writes no byte earlier than the
trace lets it pass (a token bucket without depth). The player runs against it by the real clock, then over the
simulated link with the same settings; neither pipelines batches. Prints, for each trace, how far real arrivals were
from the simulated ones, as long as both asked for the same, and the figures of both sessions.
"""

from __future__ import annotations

import argparse
import socket
import threading
import time
from pathlib import Path

import numpy as np

from airgs_codec.play.catalogue import HEADER_BYTES
from airgs_codec.play.http import HttpDownloader, open_catalogue
from airgs_codec.play.link import Link
from airgs_codec.play.player import run
from airgs_codec.play.policies.named import make_policy
from airgs_codec.play.session import SessionLog, simulate
from airgs_codec.play.settings import SessionSettings
from airgs_codec.play.trace import open_trace

TICK_S = 0.001  # between two looks at the bucket
SMALLEST_BYTES = 1200  # that are written at once
WAIT_S = 5.0  # for the next request


class ShapedServer:
    """Serves a folder over HTTP/1.1: at full speed until `shape` is called, from the next request on over the link."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._link: Link | None = None
        self._zero: float | None = None  # when the trace began
        self._listening = socket.create_server(("127.0.0.1", 0))
        self.url = f"http://127.0.0.1:{self._listening.getsockname()[1]}"
        threading.Thread(target=self._serve, daemon=True).start()

    def shape(self, link: Link) -> None:
        """The trace begins with the next request."""
        self._link, self._zero = link, None

    def close(self) -> None:
        """Stop listening."""
        self._listening.close()

    def _serve(self) -> None:
        while True:
            try:
                connection, _ = self._listening.accept()
            except OSError:  # closed
                return
            with connection:
                connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                connection.settimeout(WAIT_S)
                self._answer(connection)

    def _answer(self, connection: socket.socket) -> None:
        """Answer batches until the client goes; the requests of a batch come in one piece."""
        while True:
            try:
                requests = connection.recv(1 << 16)
                if not requests:
                    return
                self._write(connection, b"".join(self._response(line) for line in _paths(requests)))
            except OSError:  # the client has given up
                return

    def _response(self, path: str) -> bytes:
        file = self._folder / path
        body = file.read_bytes() if file.is_file() else b""
        status = "200 OK" if file.is_file() else "404 Not Found"
        head = f"HTTP/1.1 {status}\r\nContent-Length: {len(body)}\r\nX-Pad: "
        return (head + "x" * (HEADER_BYTES - len(head) - 4) + "\r\n\r\n").encode() + body

    def _write(self, connection: socket.socket, data: bytes) -> None:
        """A batch, a round trip late and as fast as the trace lets it pass."""
        if self._link is None:
            connection.sendall(data)
            return
        self._zero = time.monotonic() if self._zero is None else self._zero
        time.sleep(self._link.rtt_s)
        began_s, sent = time.monotonic() - self._zero, 0
        while sent < len(data):
            allowed = int(self._link.bytes_between(began_s, time.monotonic() - self._zero)) - sent
            if allowed >= min(SMALLEST_BYTES, len(data) - sent):
                connection.sendall(data[sent : sent + allowed])
                sent += allowed
            else:
                time.sleep(TICK_S)


def _paths(requests: bytes) -> list[str]:
    """Paths of GET requests that follow one another, relative to the folder."""
    return [part.split(b" ")[1].decode().lstrip("/") for part in requests.split(b"\r\n\r\n") if part]


def play_really(server: ShapedServer, link: Link, policy: str, settings: SessionSettings) -> SessionLog:
    """A session over the shaped server, by the clock."""
    catalogue = open_catalogue(server.url)
    server.shape(link)
    downloader = HttpDownloader(server.url, catalogue)
    events = run(catalogue, downloader, make_policy(policy, catalogue, link), settings)
    log = SessionLog.of(events, catalogue, policy, settings)
    downloader.close()
    return log


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
    for name in args.traces:
        server, link = ShapedServer(args.package), Link(open_trace(name))
        catalogue = open_catalogue(server.url)
        loops = max(1, round(args.seconds / catalogue.duration_s))
        settings = SessionSettings(loops=loops, pipelined=False)
        real = play_really(server, link, args.policy, settings)
        server.close()
        simulated = simulate(catalogue, link, args.policy, settings)
        same, mean, worst = compare(real, simulated)
        batches = f"{same} of {len(simulated.fetches)}"
        quality = f"{real.metrics.psnr_mean or 0:.2f} / {simulated.metrics.psnr_mean or 0:.2f} dB"
        stalls = f"{real.metrics.stall_s:.2f} / {simulated.metrics.stall_s:.2f} s"
        print(f"{Path(name).name:<32}{batches:>14}{100 * mean:13.2f} %{100 * worst:7.2f} %{quality:>26}{stalls:>18}")


if __name__ == "__main__":
    main()
