"""A job: a function of this package, what it reads, and the name of its result; and what a worker does with it."""

from __future__ import annotations

import os
import pickle
import platform
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from airgs_codec.errors import WorkError
from airgs_codec.jobs.digest import code_digest
from airgs_codec.jobs.store import Store


@dataclass(frozen=True, slots=True)
class Stored:
    """In place of an argument: the result of another job, which the worker reads from the store."""

    entry: str


@dataclass(frozen=True, slots=True, eq=False)
class Job:
    """One piece of work. Repeating it gives the same result."""

    kind: str  # for people: survey, key, ...
    label: str  # for people: which frames
    entry: str  # name of its result: a digest of everything that it reads
    function: Callable[..., Any]  # of a module, so that other processes find it
    arguments: tuple[Any, ...] = ()  # each may be `Stored`
    code: str = ""  # that makes the result (`digest.code_digest`); empty: any
    libraries: tuple[str, ...] = ()  # that `code` counts in
    needs: Mapping[str, float] = field(default_factory=dict)  # resources of a worker, as {"GPU": 1}

    @property
    def result(self) -> Stored:
        """Its result as an argument of another job."""
        return Stored(self.entry)


@dataclass(frozen=True, slots=True)
class Record:
    """Who did a job, and when."""

    kind: str
    label: str
    worker: str  # machine and process
    begun: float  # seconds since the epoch
    seconds: float
    bytes: int  # of its result


class LostResultError(WorkError):
    """A result that another job reads is not in the store any more, or was damaged there."""

    def __init__(self, place: str, entry: str) -> None:
        super().__init__(f"{place}: expected the result {entry[:12]}, which is gone; begin again")
        self.entry = entry


def perform(store: Store, job: Job) -> Record:
    """Do a job unless its result is there: all that a worker does.

    Raises what the function raises, LostResultError where something that it reads is not in the store, and WorkError on
    a worker with another version of this package or its libraries.
    """
    if job.code not in ("", code_digest(*job.libraries)):
        names = ", ".join(["airgs-codec", "numpy", "numba", *job.libraries])
        version = f"expected the version of {names} and FFmpeg that the command has, got another one"
        raise WorkError(f"worker {platform.node()}: {version}")
    known = read_record(store, job.entry)
    if known is not None and store.has(job.entry):
        return known
    begun, start = time.time(), time.perf_counter()
    value = job.function(*(read_result(store, a) if isinstance(a, Stored) else a for a in job.arguments))
    seconds = time.perf_counter() - start
    data = pickle.dumps(value, protocol=5)
    record = Record(job.kind, job.label, f"{platform.node()}:{os.getpid()}", begun, seconds, len(data))
    store.write(job.entry, data)
    store.write(_record_of(job.entry), pickle.dumps(record))
    return record


def load(store: Store, entry: str) -> tuple[Any] | None:
    """The result of a job; None where it is not there, which a result of None is not."""
    data = store.read(entry)
    return None if data is None else (pickle.loads(data),)


def read_record(store: Store, entry: str) -> Record | None:
    """Who did a job and when; None where that is not known."""
    data = store.read(_record_of(entry))
    record = None if data is None else pickle.loads(data)
    assert record is None or isinstance(record, Record)
    return record


def _record_of(entry: str) -> str:
    return f"{entry}.record"


def read_result(store: Store, stored: Stored) -> Any:
    """The result that stands for an argument. Raises LostResultError where it is not there."""
    found = load(store, stored.entry)
    if found is None:
        raise LostResultError(store.name, stored.entry)
    return found[0]
