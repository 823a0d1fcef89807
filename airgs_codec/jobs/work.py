"""Runs jobs that are not done yet, and gives results: what an encode or a training asks its work for."""

from __future__ import annotations

import dataclasses
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from airgs_codec.errors import AirgsError, WorkError
from airgs_codec.jobs.engines import Engine, InProcess
from airgs_codec.jobs.job import (
    Job,
    LostResultError,
    Record,
    Stored,
    code_digest,
    digest,
    load,
    packages_of,
    perform,
    read_record,
)
from airgs_codec.places.results import Store, open_store, pack
from airgs_codec.progress import Progress, silent

LOSSES = 100  # results that are found to be gone while jobs of one kind are done, and made again


@dataclass(frozen=True, slots=True, eq=False)
class Work:
    """Jobs are done by an engine, each once; results stay in a store."""

    store: Store
    engine: Engine = field(default_factory=InProcess)
    progress: Progress = silent  # is told of jobs, and of what else goes on between them
    asked: dict[str, Job] = field(default_factory=dict)  # all jobs so far by their entries, in order

    def run(self, jobs: Sequence[Job]) -> None:
        """Do all jobs whose results are not there; they are of one kind and need the same, none what another gives.

        Raises what a job raises, WorkError where workers die of it, OSError (TransportError) where the store fails.
        """
        unique = {job.entry: job for job in jobs}
        self.asked.update(unique)
        for left in range(LOSSES, -1, -1):
            try:
                return self._run_missing(list(unique.values()))
            except LostResultError as error:
                lost = self.asked.get(error.entry)
                if lost is None or not left:
                    raise
                self.run([lost])

    def _run_missing(self, unique: Sequence[Job]) -> None:
        missing = [job for job in unique if not self.store.has(job.entry)]
        done = len(unique) - len(missing)
        if not missing:
            return
        self.progress(missing[0].kind, done, len(unique))
        for _ in self.engine.map(perform, [(self.store, job) for job in missing], missing[0].needs):
            done += 1
            self.progress(unique[0].kind, done, len(unique))

    def result(self, job: Job) -> Any:
        """The result of a job, which is done here where it is not there."""
        self.asked[job.entry] = job
        found = load(self.store, job.entry, packages_of(job))
        if found is None:
            self.run([job])
            found = load(self.store, job.entry, packages_of(job))
        if found is None:
            raise WorkError(f"{self.store.name}: expected the result that was just written, {job.entry[:12]}, got none")
        return found[0]

    def cached(self, job: Job, cache: Store) -> tuple[Any, bool]:
        """Return the result of a job and whether it came from a cache, which gets it otherwise.

        A result that is in the store is taken from there, so that runs that share it have the same. A cache that cannot
        be read or written is no reason to fail.
        """
        if not self.store.has(job.entry):
            with suppress(OSError, AirgsError):
                if found := load(cache, job.entry, packages_of(job)):
                    self.store.write(job.entry, pack(found[0]))
                    return found[0], True
        value = self.result(job)
        with suppress(OSError, AirgsError):
            cache.write(job.entry, pack(value))
        return value, False

    def put(self, value: Any) -> Stored:
        """A value as an argument of jobs, stored once by the name of its content. Raises TypeError as `digest` does."""
        entry = digest(code_digest(type(value)) if dataclasses.is_dataclass(value) else "", value)
        if not self.store.has(entry):
            self.store.write(entry, pack(value))
        return Stored(entry)

    def map(self, stage: str, function: Callable[..., Any], calls: Sequence[tuple[Any, ...]]) -> list[Any]:
        """Return what a function gives for each tuple of arguments, in their order; nothing is stored."""
        results: dict[int, Any] = {}
        for place, value in self.engine.map(_numbered, [(function, place, *call) for place, call in enumerate(calls)]):
            results[place] = value
            self.progress(stage, len(results), len(calls))
        return [results[place] for place in range(len(calls))]

    def records(self) -> list[Record]:
        """Who did the jobs asked for so far, and when: those of which it is known."""
        found = (read_record(self.store, entry) for entry in self.asked)
        return [record for record in found if record is not None]


def _numbered(function: Callable[..., Any], place: int, *arguments: Any) -> tuple[int, Any]:
    return place, function(*arguments)


@contextmanager
def temporary_work(progress: Progress = silent) -> Iterator[Work]:
    """Work in this process whose results nobody needs afterwards."""
    with tempfile.TemporaryDirectory(prefix="airgs-work-") as folder:
        yield Work(open_store(Path(folder), lasting=False), progress=progress)
