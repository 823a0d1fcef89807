"""How airgs-serve holds out: many sessions on loopback, their errors, times to the first byte, the server's memory.

    python -m tools.bench_serve PACKAGE [--sessions N] [--seconds S] [--requests R]

Each session keeps one connection and asks for the files of the package in turn, R a second on average. Every answer is
compared with the file on disk. Time to the first byte counts from the request to the end of the answer's headers, and
includes what the clients, which share this machine and one process, add to it.
"""

from __future__ import annotations

import argparse
import asyncio
import os
import random
import re
import subprocess
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

SERVE = "import sys; from airgs_codec.cli.serve import main; sys.exit(main())"
WARM_S = 5.0  # after which memory counts
SAMPLE_S = 5.0
TIMEOUT_S = 10.0


@dataclass(slots=True, eq=False)
class Tally:
    """What all sessions saw."""

    first_byte_s: list[float] = field(default_factory=list)
    bytes: int = 0
    cpu_s: float = 0.0  # of the server, its start included
    errors: list[str] = field(default_factory=list)
    memory_mb: list[tuple[float, float]] = field(default_factory=list)  # (s, MB) of the server


async def session(port: int, files: dict[str, bytes], pause_s: float, end_s: float, tally: Tally) -> None:
    """Ask for one file after another until the end; an error ends it."""
    await asyncio.sleep(random.random() * min(2.0, pause_s * 8))
    try:
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        paths = list(files)
        at = random.randrange(len(paths))
        while time.monotonic() < end_s:
            path = paths[at % len(paths)]
            await asyncio.wait_for(fetch(reader, writer, path, files[path], tally), TIMEOUT_S)
            at += 1
            await asyncio.sleep(random.expovariate(1 / pause_s))
        writer.close()
    except (OSError, ValueError, EOFError) as error:
        tally.errors.append(repr(error))


async def fetch(
    reader: asyncio.StreamReader, writer: asyncio.StreamWriter, path: str, expected: bytes, tally: Tally
) -> None:
    """One file. Raises ValueError for an answer that is not this file."""
    sent_s = time.monotonic()
    writer.write(f"GET {path} HTTP/1.1\r\nHost: localhost\r\n\r\n".encode())
    head = await reader.readuntil(b"\r\n\r\n")
    tally.first_byte_s.append(time.monotonic() - sent_s)
    length = re.search(rb"content-length: (\d+)", head, re.IGNORECASE)
    if not head.startswith(b"HTTP/1.1 200") or not length:
        raise ValueError(f"{path}: {head[:60]!r}")
    body = await reader.readexactly(int(length[1]))
    tally.bytes += len(body)
    if body != expected:
        raise ValueError(f"{path}: other bytes than on disk")


async def watch(process: int, end_s: float, tally: Tally) -> None:
    """Look at the server's memory now and then."""
    began_s = time.monotonic()
    while time.monotonic() < end_s:
        kilobytes = re.search(r"VmRSS:\s+(\d+) kB", Path(f"/proc/{process}/status").read_text())
        if kilobytes:
            tally.memory_mb.append((time.monotonic() - began_s, int(kilobytes[1]) / 1024))
        await asyncio.sleep(SAMPLE_S)


async def measure(process: int, port: int, files: dict[str, bytes], args: argparse.Namespace) -> Tally:
    """All sessions at once."""
    tally, end_s = Tally(), time.monotonic() + args.seconds
    sessions = (session(port, files, 1 / args.requests, end_s, tally) for _ in range(args.sessions))
    await asyncio.gather(watch(process, end_s, tally), *sessions)
    return tally


def summary(tally: Tally, seconds: float) -> str:
    """The figures in words."""
    p50, p95, p99, worst = 1e3 * np.percentile(tally.first_byte_s, (50, 95, 99, 100))
    warm = [mb for at_s, mb in tally.memory_mb if at_s >= WARM_S] or [mb for _, mb in tally.memory_mb]
    shown = ", ".join(f"{mb:.1f}" for mb in warm[:: max(1, len(warm) // 10)])
    return "\n".join(
        [
            f"{len(tally.first_byte_s)} answers, {len(tally.first_byte_s) / seconds:.0f} a second, "
            f"{8e-6 * tally.bytes / seconds:.0f} Mbit/s, {len(tally.errors)} errors",
            f"server: {1e3 * tally.cpu_s / len(tally.first_byte_s):.2f} ms of a core an answer; load average "
            f"{os.getloadavg()[0]:.1f} on {os.cpu_count()} cores",
            f"first byte: median {p50:.1f} ms, p95 {p95:.1f} ms, p99 {p99:.1f} ms, worst {worst:.1f} ms",
            f"memory: {warm[0]:.1f} MB after {WARM_S:g} s, {warm[-1]:.1f} MB at the end ({shown})",
            *tally.errors[:5],
        ]
    )


def main() -> int:
    """Serve, measure and print; exit status 1 where there were errors."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("package", type=Path)
    parser.add_argument("--sessions", type=int, default=200)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--requests", type=float, default=4.0, help="a second and session (default: %(default)g)")
    args = parser.parse_args()
    files = {
        f"/{args.package.name}/{path.relative_to(args.package).as_posix()}": path.read_bytes()
        for path in sorted(args.package.rglob("*"))
        if path.is_file()
    }
    command = [sys.executable, "-c", SERVE, str(args.package), "--port", "0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server:
        assert server.stdout
        port = int(server.stdout.readline().rstrip("/\n").rpartition(":")[2])
        tally = asyncio.run(measure(server.pid, port, files, args))
        user, system = Path(f"/proc/{server.pid}/stat").read_text().rpartition(")")[2].split()[11:13]
        tally.cpu_s = (int(user) + int(system)) / os.sysconf("SC_CLK_TCK")
        server.terminate()
    print(summary(tally, args.seconds))
    return int(bool(tally.errors))


if __name__ == "__main__":
    sys.exit(main())
