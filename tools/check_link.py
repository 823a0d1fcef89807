"""Simulated arrival times against real HTTP over loopback, shaped by the same trace.

    python -m tools.check_link PACKAGE TRACE [TRACE ...] [--seconds S] [--policy NAME]

A session is simulated; then a real client asks a real HTTP/1.1 server for as many bytes at the same times, a request a
batch on one connection, pipelined. The server holds every answer back until a round trip after its request and writes
no byte earlier than the trace lets it pass (a token bucket without depth). Prints, for each trace, how far real
arrivals were from the simulated ones.
"""

from __future__ import annotations

import argparse
import socket
import threading
import time
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import numpy as np

from airgs_codec.package.store import open_package
from airgs_codec.play.catalogue import HEADER_BYTES, Catalogue
from airgs_codec.play.link import Link
from airgs_codec.play.session import SessionLog, simulate
from airgs_codec.play.settings import SessionSettings
from airgs_codec.play.trace import open_trace

TICK_S = 0.001  # between two looks at the bucket


class ShapedServer:
    """GET /N answers with N bytes, headers included in what the link carries; the clock starts with `start`."""

    def __init__(self, link: Link) -> None:
        """Listens on a free port of loopback."""
        shaped = self
        self.link, self.zero = link, time.monotonic()
        self._passed = 0.0  # bytes of the batch so far, and the moment its first one could pass
        self._began = 0.0

        class Handler(BaseHTTPRequestHandler):
            protocol_version = "HTTP/1.1"
            disable_nagle_algorithm = True  # else the last bytes of an answer wait for an acknowledgement, 40 ms late

            def do_GET(self) -> None:
                size = int(self.path.strip("/"))
                asked = shaped.zero + float(self.headers["X-Asked"])
                time.sleep(max(0.0, asked + shaped.link.rtt_s - time.monotonic()))
                shaped.begin()
                head = f"HTTP/1.1 200 OK\r\nContent-Length: {size}\r\nX-Pad: "
                pad = "x" * (HEADER_BYTES - len(head) - 4)
                shaped.write(self.connection, (head + pad + "\r\n\r\n").encode() + bytes(size))

            def log_message(self, format: str, *args: object) -> None:
                """Silent."""

        self._server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self._server.daemon_threads = True
        self.port = self._server.server_address[1]
        threading.Thread(target=self._server.serve_forever, daemon=True).start()

    def start(self) -> None:
        """The trace begins now."""
        self.zero = time.monotonic()

    def begin(self) -> None:
        """A batch begins: nothing has passed."""
        self._began, self._passed = time.monotonic() - self.zero, 0.0

    def write(self, connection: socket.socket, data: bytes) -> None:
        """As fast as the trace lets it pass."""
        sent = 0
        while sent < len(data):
            allowed = self.link.bytes_between(self._began, time.monotonic() - self.zero) - self._passed
            if allowed >= min(1200, len(data) - sent):
                part = data[sent : sent + int(allowed)]
                connection.sendall(part)
                sent += len(part)
                self._passed += len(part)
            else:
                time.sleep(TICK_S)

    def close(self) -> None:
        """Stop listening."""
        self._server.shutdown()
        self._server.server_close()


def ask(client: socket.socket, log: SessionLog, zero: float) -> None:
    """Send every request at its time, whether the answer before it is there or not."""
    for fetch in log.fetches:
        time.sleep(max(0.0, fetch.request_s - (time.monotonic() - zero)))
        asked = time.monotonic() - zero
        lines = f"GET /{fetch.bytes - HEADER_BYTES} HTTP/1.1\r\nHost: x\r\nX-Asked: {asked:.6f}\r\n\r\n"
        client.sendall(lines.encode())


def replay(log: SessionLog, link: Link) -> list[float]:
    """Ask for every batch of a session at its simulated time; gives seconds of arrival."""
    server = ShapedServer(link)
    arrivals = []
    with socket.create_connection(("127.0.0.1", server.port)) as client:
        client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        server.start()
        asking = threading.Thread(target=ask, args=(client, log, server.zero), daemon=True)
        asking.start()
        for fetch in log.fetches:
            left = fetch.bytes
            while left:
                left -= len(client.recv(min(left, 1 << 16)))
            arrivals.append(time.monotonic() - server.zero)
    server.close()
    return arrivals


def main() -> None:
    """Replay and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("package", type=Path)
    parser.add_argument("traces", nargs="+")
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--policy", default="robust-mpc")
    args = parser.parse_args()
    package = open_package(args.package)
    c = Catalogue.of(package)
    loops = max(1, round(args.seconds / sum(c.seconds)))
    print(f"{'trace':<32}{'batches':>8}{'arrival: mean':>15}{'worst':>9}{'time on the way, real / simulated':>36}")
    for name in args.traces:
        link = Link(open_trace(name))
        rules = SessionSettings(loops=loops, abandon=False)
        log = simulate(c, link, args.policy, rules)
        real = np.array(replay(log, link))
        simulated = np.array([f.arrival_s for f in log.fetches])
        asked = np.array([f.request_s for f in log.fetches])
        error = np.abs(real - simulated) / simulated
        ratio = (real - asked).sum() / (simulated - asked).sum()
        print(f"{Path(name).name:<32}{len(real):8d}{100 * error.mean():13.2f} %{100 * error.max():7.2f} %{ratio:36.3f}")


if __name__ == "__main__":
    main()
