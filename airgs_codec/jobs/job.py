"""A job: a function of this package, what it reads, and the name of its result; and what a worker does with it."""

from __future__ import annotations

import os
import platform
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from airgs_codec.errors import WorkError
from airgs_codec.jobs.digest import code_digest, digest, module_name
from airgs_codec.jobs.engines import NOTHING, Needs
from airgs_codec.places.results import OWN, Store, pack, unpack


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
    needs: Needs = field(default_factory=dict)  # resources of a worker, as {"GPU": 1}

    @staticmethod
    def of(
        kind: str, label: str, function: Callable[..., Any], arguments: tuple[Any, ...], content: Any,
        needs: Needs = NOTHING,
    ) -> Job:  # fmt: skip
        """Return a job whose result is named by its kind, by `content`, which is all that it reads, and by its code."""
        code = code_digest(function)
        return Job(kind, label, digest(code, kind, content), function, arguments, code, needs)

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

    Raises what the function raises, LostResultError where something that it reads is not in the store, TypeError for a
    result that is no value that `places.results.pack` takes, and WorkError on a worker with another version of this
    package or its libraries.
    """
    if job.code not in ("", code_digest(job.function)):
        version = "expected the version of airgs-codec, its libraries and FFmpeg that the command has, got another one"
        raise WorkError(f"worker {platform.node()}: {version}")
    known = read_record(store, job.entry)
    if known is not None and store.has(job.entry):
        return known
    begun, start = time.time(), time.perf_counter()
    own = packages_of(job)
    value = job.function(*(read_result(store, a, own) if isinstance(a, Stored) else a for a in job.arguments))
    seconds = time.perf_counter() - start
    data = pack(value)
    record = Record(job.kind, job.label, f"{platform.node()}:{os.getpid()}", begun, seconds, len(data))
    store.write(job.entry, data)
    store.write(_record_of(job.entry), pack(record))
    return record


def load(store: Store, entry: str, trusted: tuple[str, ...] = OWN) -> tuple[Any] | None:
    """The result of a job; None where it is not there, which a result of None is not.

    One that is no value, or of a dataclass that is no more, is removed. `trusted` as `places.results.unpack` takes it.
    """
    data = store.read(entry)
    try:
        return None if data is None else (unpack(data, trusted),)
    except ValueError:
        store.delete(entry)
        return None


def packages_of(job: Job) -> tuple[str, ...]:
    """The packages whose dataclasses a job reads and makes: this one, and that of its function."""
    return (*OWN, module_name(job.function).partition(".")[0])


def read_record(store: Store, entry: str) -> Record | None:
    """Who did a job and when; None where that is not known."""
    found = load(store, _record_of(entry))
    return found[0] if found and isinstance(found[0], Record) else None


def _record_of(entry: str) -> str:
    return f"{entry}.record"


def read_result(store: Store, stored: Stored, trusted: tuple[str, ...] = OWN) -> Any:
    """The result that stands for an argument. Raises LostResultError where it is not there."""
    found = load(store, stored.entry, trusted)
    if found is None:
        raise LostResultError(store.name, stored.entry)
    return found[0]
