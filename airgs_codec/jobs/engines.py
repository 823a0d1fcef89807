"""Where jobs are done: in this process, or in processes of this machine."""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from typing import Any, Protocol

from airgs_codec._settings import available_cores
from airgs_codec.errors import WorkError

DEATHS = 3  # of workers that a job may cause before it is given up
LEAVE_S = 5.0  # for a process to remove what it has begun

Calls = Sequence[tuple[Any, ...]]  # the arguments of each
Needs = Mapping[str, float]  # how much of which resource a call takes of its worker, as {"GPU": 1}
NOTHING: Needs = {}


class Engine(Protocol):
    def map(self, function: Callable[..., Any], calls: Calls, needs: Needs = NOTHING) -> Iterator[Any]:
        """Return what `function` gives for each tuple of arguments, as they are finished.

        `needs`: resources that the worker of each call must have, where workers are told apart. Raises what a call
        raises first; others are given up then. WorkError where its workers die, or none has what is needed.
        """

    def close(self) -> None:
        """Give back what it holds. It may be used again."""


@dataclass(frozen=True, slots=True)
class InProcess:
    def map(self, function: Callable[..., Any], calls: Calls, needs: Needs = NOTHING) -> Iterator[Any]:
        for call in calls:
            yield function(*call)

    def close(self) -> None:
        pass


class Processes:
    """So many processes of this machine, which share its cores. When one dies, all are replaced and go on."""

    def __init__(self, count: int, threads: int | None = None) -> None:
        """`threads` of each process, by default the share of the cores that `count` leaves it."""
        self.count = count
        self._threads = threads or max(1, available_cores() // count)
        self._pool: ProcessPoolExecutor | None = None

    def map(self, function: Callable[..., Any], calls: Calls, needs: Needs = NOTHING) -> Iterator[Any]:
        """Also raises WorkError where DEATHS processes have died one after another."""
        left, deaths = dict(enumerate(calls)), 0
        while left:
            try:
                for place, value in self._finish(function, left):
                    del left[place]
                    deaths = 0
                    yield value
            except BrokenProcessPool as error:
                self.close()
                deaths += 1
                if deaths >= DEATHS:
                    words = f"{deaths} workers died in a row, {len(left)} are left: is there memory for {self.count}?"
                    raise WorkError(words) from error

    def _finish(self, function: Callable[..., Any], calls: dict[int, tuple[Any, ...]]) -> Iterator[tuple[int, Any]]:
        """Places and values as they are finished. Raises BrokenProcessPool where a process died."""
        if self._pool is None:
            context = multiprocessing.get_context("spawn")
            self._pool = ProcessPoolExecutor(
                self.count, context, initializer=prepare_worker, initargs=(os.getpid(), self._threads)
            )
        waiting: dict[Future[Any], int] = {}
        todo = iter(list(calls.items()))
        try:
            while True:
                for place, call in todo:
                    waiting[self._pool.submit(function, *call)] = place
                    if len(waiting) > 2 * self.count:  # all arguments at once may not fit into memory
                        break
                if not waiting:
                    return
                for future in wait(waiting, return_when=FIRST_COMPLETED).done:
                    yield waiting.pop(future), future.result()
        finally:
            for future in waiting:
                future.cancel()

    def close(self) -> None:
        """End the processes, whatever they are doing."""
        if self._pool is None:
            return
        processes = list((self._pool._processes or {}).values())
        self._pool.shutdown(wait=False, cancel_futures=True)
        for process in processes:
            process.terminate()
        for process in processes:  # each removes what it has begun
            process.join(LEAVE_S)
            process.kill()
        self._pool = None


def prepare_worker(parent: int, threads: int) -> None:
    """Called first in a new process: so many threads for kernels; it ends when it is told to or its parent has ended.

    numba has been imported by then, as `spawn` runs the main module of the parent again.
    """
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
    from airgs_codec.render.cpu import use_threads

    use_threads(threads)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent ends its workers

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(1)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
