"""How airgs-serve holds out: many sessions on loopback, their errors, times to the first byte, the server's memory.

Each session keeps one connection and asks for the files of the package in turn. Every answer is compared with the file
on disk; errors end with exit status 1. Time to the first byte counts from the request to the end of the answer's
headers, and includes what the clients, which share this machine and one process, add to it.
"""

from __future__ import annotations

import asyncio
import os
import random
import re
import time
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from tools.lab import Lab, Page, Section, Table, memory_of, required, setting
from tools.lab.serving import airgs_serve

WARM_S = 5.0  # after which memory counts
SAMPLE_S = 5.0
TIMEOUT_S = 10.0


@dataclass(frozen=True, slots=True)
class Options:
    """Who asks for what."""

    package: Path = required("a package")
    sessions: int = setting(200, "sessions at once")
    seconds: float = setting(60.0, "how long")
    requests: float = setting(4.0, "a second and session, on average")


def run(options: Options, lab: Lab) -> Page:
    """Serve and measure."""
    files = {
        f"/{options.package.name}/{path.relative_to(options.package).as_posix()}": path.read_bytes()
        for path in sorted(options.package.rglob("*"))
        if path.is_file()
    }
    with airgs_serve(options.package) as (server, url):
        tally = asyncio.run(measure(server.pid, int(url.rpartition(":")[2]), files, options))
        user, system = Path(f"/proc/{server.pid}/stat").read_text().rpartition(")")[2].split()[11:13]
        tally.cpu_s = (int(user) + int(system)) / os.sysconf("SC_CLK_TCK")
    row = row_of(tally, options.seconds)
    answer = f"{options.sessions} sessions got {len(tally.first_byte_s):,d} answers with {len(tally.errors)} errors, "
    answer += f"{row['answers a second']:,.0f} a second. {' '.join(tally.errors[:5])}"
    return Page([Section(answer.strip(), tables=[Table("serve", [row])])], failed=bool(tally.errors))


def row_of(tally: Tally, seconds: float) -> dict[str, float]:
    """The figures of all sessions."""
    p50, p95, p99, worst = 1e3 * np.percentile(tally.first_byte_s, (50, 95, 99, 100))
    warm = [mb for at_s, mb in tally.memory_mb if at_s >= WARM_S] or [mb for _, mb in tally.memory_mb]
    return {
        "answers a second": len(tally.first_byte_s) / seconds, "Mbit/s": 8e-6 * tally.bytes / seconds,
        "ms of a core an answer": 1e3 * tally.cpu_s / len(tally.first_byte_s), "first byte, ms": p50,
        "95 %": p95, "99 %": p99,
        "worst": worst, "MB when warm": warm[0], "MB at the end": warm[-1], "errors": len(tally.errors),
        "load average": os.getloadavg()[0],
    }  # fmt: skip


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
        tally.memory_mb.append((time.monotonic() - began_s, memory_of(process) / 1e6))
        await asyncio.sleep(SAMPLE_S)


async def measure(process: int, port: int, files: dict[str, bytes], options: Options) -> Tally:
    """All sessions at once."""
    tally, end_s = Tally(), time.monotonic() + options.seconds
    sessions = (session(port, files, 1 / options.requests, end_s, tally) for _ in range(options.sessions))
    await asyncio.gather(watch(process, end_s, tally), *sessions)
    return tally
