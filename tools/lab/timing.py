"""How long work takes and how much memory it needs, and on what machine."""

from __future__ import annotations

import importlib.metadata
import multiprocessing
import os
import platform
import resource
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from statistics import median
from typing import Any, NamedTuple, TypeVar

T = TypeVar("T")


class Took(NamedTuple):
    cpu: float  # seconds of the CPU, of all threads of this process together: what other work changes little
    wall: float  # seconds by the clock on the wall

    def times(self, factor: float) -> Took:
        return Took(self.cpu * factor, self.wall * factor)


class Alone(NamedTuple):
    """What a piece of work took in a process of its own."""

    took: Took
    peak_mb: float  # most memory of that process with Python and its libraries, and of its largest child; 10^6 bytes


def seconds_of(work: Callable[[], T]) -> tuple[Took, T]:
    cpu, wall = time.process_time(), time.perf_counter()
    result = work()
    return Took(time.process_time() - cpu, time.perf_counter() - wall), result


def timed(work: Callable[[], object], repeats: int) -> list[Took]:
    """Return what each of some calls took, after one that compiles and fills caches."""
    work()
    return [seconds_of(work)[0] for _ in range(repeats)]


def middle(took: Sequence[Took]) -> Took:
    return Took(median(t.cpu for t in took), median(t.wall for t in took))


def alone(function: Callable[..., Any], *arguments: Any, limit_s: float | None = None) -> tuple[Alone, Any]:
    """Return what one call of a function of a module took in a fresh process, and what it gives.

    Raises what the function raises, TimeoutError after `limit_s` seconds, BrokenProcessPool where the process dies.
    """
    others = set(multiprocessing.active_children())
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
        try:
            return pool.submit(_measured, function, arguments).result(limit_s)
        except TimeoutError:
            for process in set(multiprocessing.active_children()) - others:
                process.kill()
            raise


def _measured(function: Callable[..., Any], arguments: tuple[Any, ...]) -> tuple[Alone, Any]:
    took, result = seconds_of(lambda: function(*arguments))
    # Linux; getrusage would begin with the most that the parent had
    peak = next(line for line in Path("/proc/self/status").read_text().splitlines() if line.startswith("VmHWM:"))
    children = 1024 * resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss
    return Alone(took, (1024 * int(peak.split()[1]) + children) / 1e6), result


def machine(*libraries: str) -> str:
    """Return where it was measured, and with which versions of PyAV, numpy, numba and further `libraries`."""
    versions = [f"{name} {importlib.metadata.version(name)}" for name in ("av", "numpy", "numba", *libraries)]
    return f"{os.cpu_count()} {platform.machine()} cores, Python {platform.python_version()}, {', '.join(versions)}"
