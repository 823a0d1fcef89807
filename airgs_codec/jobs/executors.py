"""Executors: processes of this machine that are replaced when one dies, and the workers of a Dask cluster.

Any `concurrent.futures.Executor` will do where one is asked for.
"""

from __future__ import annotations

import logging
import os
import signal
import sys
import threading
import time
from collections.abc import Callable
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from functools import partial
from multiprocessing import get_context
from typing import Any

from airgs_codec._settings import available_cores
from airgs_codec.errors import WorkError
from airgs_codec.render.cpu import use_threads

DEATHS = 3  # of workers in a row, after which calls fail
LEAVE_S = 5.0  # for a process to remove unfinished files
RETRIES = 2  # of a call whose disk or network fails
CONNECT_S = 5  # to a Dask scheduler
WORKER_S = 60  # for a worker with the resources of a call to start


class Processes(Executor):
    """Processes of this machine, which share its cores; calls of one that dies are made again in another."""

    def __init__(self, count: int) -> None:
        self._count, self._threads = count, max(1, available_cores() // count)
        self._lock, self._pool = threading.Lock(), self._begin()
        self._deaths = 0  # pools that broke since a call was last finished

    def _begin(self) -> ProcessPoolExecutor:
        return ProcessPoolExecutor(self._count, get_context("spawn"), prepare_worker, (os.getpid(), self._threads))

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Return a future, which raises WorkError where DEATHS processes died while no call was finished."""
        shown: Future[Any] = Future()
        self._send(shown, partial(fn, *args, **kwargs))
        return shown

    def _send(self, shown: Future[Any], call: Callable[[], Any]) -> None:
        done: Future[Any] | None = None
        with self._lock:
            try:
                done = self._pool.submit(call)
            except BrokenProcessPool:
                self._pool, self._deaths = self._begin(), self._deaths + 1
                if self._deaths < DEATHS:
                    done = self._pool.submit(call)
        if done:
            done.add_done_callback(partial(self._finish, shown, call))
        else:
            shown.set_exception(WorkError(f"{DEATHS} workers died in a row: is there memory for {self._count}?"))

    def _finish(self, shown: Future[Any], call: Callable[[], Any], done: Future[Any]) -> None:
        if done.cancelled() or shown.cancelled():
            shown.cancel()
        elif isinstance(error := done.exception(), BrokenProcessPool):
            self._send(shown, call)
        else:
            self._deaths = 0
            shown.set_result(done.result()) if error is None else shown.set_exception(error)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End the processes, whatever they are doing, unless `wait`."""
        processes = list((self._pool._processes or {}).values())
        self._pool.shutdown(wait=wait and not cancel_futures, cancel_futures=cancel_futures)
        for process in processes:
            process.terminate()
        for process in processes:  # each removes what it has begun
            process.join(LEAVE_S)
            process.kill()


def prepare_worker(parent: int, threads: int) -> None:
    """Set the threads of kernels in a new process, and end it with its parent or by SIGTERM.

    numba has been imported by then, as `spawn` runs the main module of the parent again.
    """
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
    use_threads(threads)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent ends its workers

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(1)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


class DaskCluster(Executor):
    """The workers of the Dask cluster at an address, or of one of `count` processes of this machine.

    `needs`: resources that the worker of a call must have, as {"GPU": 1}, of a cluster at an address. Raises WorkError
    where nobody answers there, or no worker has what calls need.
    """

    def __init__(self, address: str = "", count: int = 1, needs: dict[str, float] | None = None) -> None:
        import dask
        from dask.distributed import Client, LocalCluster

        logging.getLogger("distributed.client").setLevel(logging.CRITICAL)  # what it would say comes as an error
        self._cluster = None
        if not address:
            with dask.config.set({"distributed.scheduler.allowed-failures": DEATHS}):
                self._cluster = LocalCluster(n_workers=count, threads_per_worker=1, dashboard_address=None)
        try:
            self._client = Client(self._cluster or address, timeout=CONNECT_S)
        except (OSError, ValueError) as error:
            raise WorkError(f"--executor dask:{address}: {' '.join(str(error).split())}") from error
        if self._cluster:
            self._client.run(use_threads, max(1, available_cores() // count))
        resources = None if self._cluster else needs
        self._expect(resources or {})
        self._inner = self._client.get_executor(pure=False, retries=RETRIES, resources=resources)

    def _expect(self, needs: dict[str, float]) -> None:
        """Wait at most WORKER_S for a worker that has these resources."""
        until = time.monotonic() + WORKER_S
        while needs:
            workers = self._client.scheduler_info(n_workers=-1)["workers"].values()
            if any(all(worker["resources"].get(name, 0) >= n for name, n in needs.items()) for worker in workers):
                return
            if time.monotonic() > until:
                wanted = " ".join(f"{name}={n:g}" for name, n in needs.items())
                self._client.close()
                words = f"expected a worker started with --resources {wanted!r}, got {len(workers)} without"
                raise WorkError(f"--executor dask: {words}")
            time.sleep(0.2)

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Return a future, which raises WorkError where workers die of the call or the scheduler is gone."""
        shown: Future[Any] = Future()
        self._inner.submit(fn, *args, **kwargs).add_done_callback(partial(_relay, shown))
        return shown

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Leave the cluster at an address; end another."""
        self._client.close()
        if self._cluster is not None:
            logging.getLogger("distributed.nanny").setLevel(logging.CRITICAL)  # it may have to end a slow process
            self._cluster.close()


def _relay(shown: Future[Any], done: Future[Any]) -> None:
    """Pass on what became of a call, errors of Dask as a WorkError."""
    if shown.cancelled():
        return
    error = None if done.cancelled() else done.exception()
    if done.cancelled() or type(error).__name__ in ("FutureCancelledError", "CommClosedError"):
        error = WorkError("the Dask scheduler does not answer any more; begin again to go on")
    elif type(error).__name__ == "KilledWorker":
        error = WorkError(f"{DEATHS} workers died of one job: is there memory for it? ({error})")
    shown.set_result(done.result()) if error is None else shown.set_exception(error)
