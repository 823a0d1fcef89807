"""Workers of a Dask cluster (the extra `farm`), on this machine or on many."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterator
from typing import Any

import dask
from dask.distributed import Client, LocalCluster, as_completed
from distributed.client import FutureCancelledError
from distributed.comm.core import CommClosedError
from distributed.scheduler import KilledWorker

from airgs_codec._settings import available_cores
from airgs_codec.errors import AirgsError, WorkError
from airgs_codec.jobs.engines import DEATHS, NOTHING, Calls, Needs
from airgs_codec.render.cpu import use_threads

RETRIES = 2  # of a call that fails because its machine does: its disk, its network
WAITING = 4  # calls for each thread of the cluster that are sent ahead
CONNECT_S = 5
WORKER_S = 60  # for a worker that has what jobs need, to come
GONE = "the Dask scheduler does not answer any more; begin again to go on"


class DaskEngine:
    """Calls functions on a cluster. A worker that dies loses nothing: what it was doing goes to another."""

    def __init__(self, client: Client, cluster: LocalCluster | None = None, threads: int | None = None) -> None:
        """`cluster`: ends with the engine. `threads`: for the kernels of a call, by default all that a worker has."""
        self._threads = threads
        logging.getLogger("distributed.client").setLevel(logging.CRITICAL)  # what it would say comes as an error
        self._client = client
        self._cluster = cluster

    @staticmethod
    def at(address: str) -> DaskEngine:
        """The cluster whose scheduler is at an address. Raises WorkError where nobody answers there."""
        try:
            return DaskEngine(Client(address, timeout=CONNECT_S))
        except (OSError, ValueError) as error:
            raise WorkError(f"--executor dask:{address}: {' '.join(str(error).split())}") from error

    @staticmethod
    def local(count: int) -> DaskEngine:
        """A cluster of so many processes of this machine, which share its cores."""
        with dask.config.set({"distributed.scheduler.allowed-failures": DEATHS}):
            cluster = LocalCluster(n_workers=count, threads_per_worker=1, dashboard_address=None)
        return DaskEngine(Client(cluster), cluster, max(1, available_cores() // count))

    def map(self, function: Callable[..., Any], calls: Calls, needs: Needs = NOTHING) -> Iterator[Any]:
        """`needs` must have been given to workers of a cluster that others run when they were started.

        Also raises WorkError where the scheduler is gone.
        """
        resources = {} if self._cluster else dict(needs)
        if resources and calls:
            self._expect(resources)
        todo = iter(calls)
        waiting = as_completed(raise_errors=True)
        most = WAITING * max(1, sum(self._client.nthreads().values()))

        def send() -> bool:
            call = next(todo, None)
            if call is None:
                return False
            waiting.add(
                self._client.submit(
                    _call, self._threads, function, *call, pure=False, retries=RETRIES, resources=resources
                )
            )
            return True

        try:
            while waiting.count() < most and send():
                pass
            for future in waiting:
                yield future.result()
                send()
        except KilledWorker as error:
            raise WorkError(f"{DEATHS} workers died of one job: is there memory for it? ({error})") from error
        except AirgsError:
            raise
        except (FutureCancelledError, CommClosedError) as error:
            raise WorkError(GONE) from error
        except (OSError, RuntimeError) as error:  # of a call, or of a client that has given up
            if self._client.status == "running":
                raise
            raise WorkError(GONE) from error
        finally:
            waiting.clear()

    def _expect(self, resources: dict[str, float]) -> None:
        """Wait a while for a worker that has them: it may be starting still. Raises WorkError where none comes."""
        until = time.monotonic() + WORKER_S
        while True:
            workers = self._client.scheduler_info(n_workers=-1)["workers"].values()
            if any(all(w["resources"].get(name, 0) >= n for name, n in resources.items()) for w in workers):
                return
            if time.monotonic() > until:
                break
            time.sleep(0.2)
        wanted = " ".join(f"{name}={n:g}" for name, n in resources.items())
        got = f"got {len(workers)} without" if workers else "got no worker at all"
        raise WorkError(f"--executor dask: expected a worker started with --resources {wanted!r}, {got}")

    def close(self) -> None:
        """Leave the cluster; one that was made here ends."""
        self._client.close()
        if self._cluster is not None:
            logging.getLogger("distributed.nanny").setLevel(logging.CRITICAL)  # it may have to end a slow process
            self._cluster.close()


def _call(threads: int | None, function: Callable[..., Any], *arguments: Any) -> Any:
    """What a worker does. An environment variable would come too late, or reach the process that starts workers."""
    if threads is not None:
        use_threads(threads)
    return function(*arguments)
