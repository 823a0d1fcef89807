"""The one store of results: what an experiment has measured is not measured again, whoever was interrupted.

A result is a job of `airgs_codec.jobs` in a folder. Its name is a digest of what it reads, of the modules that the one
that measures imports, and of the versions of its libraries: a result of other code is never taken.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from airgs_codec.jobs.job import Job, code_digest, digest

from airgs_codec.jobs.work import Work
from airgs_codec.places.results import Store, open_store
from airgs_codec.progress import Progress, silent

T = TypeVar("T")


@dataclass(frozen=True, slots=True, eq=False)
class Results:
    store: Store
    progress: Progress = silent

    @staticmethod
    def at(folder: Path, progress: Progress = silent) -> Results:
        """Those of a folder, which is made when it is needed."""
        return Results(open_store(folder, lasting=False), progress=progress)

    def once(self, name: str, reads: Any, make: Callable[[], T]) -> T:
        """The result of this name that was made of `reads`, made now where it is not there.

        `reads`: plain values, arrays, dataclasses and mappings of them, as `digest` takes them; of files `content`.
        The result is a value that `airgs_codec.places.results.pack` takes. Raises what `make` raises, TypeError for
        other `reads`.
        """
        job = Job(name, "", digest(name, code_digest(make), _plain(reads)), make)
        return Work(self.store, progress=self.progress).result(job)


def _plain(value: Any) -> Any:
    """`value` with paths as text, which `digest` takes."""
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, tuple | list):
        return [_plain(part) for part in value]
    return {name: _plain(part) for name, part in value.items()} if isinstance(value, dict) else value


def content(path: Path) -> str:
    """A digest of a file, or of all files of a folder with their names. Raises OSError."""
    if path.is_file():
        return digest(path.read_bytes())
    files = sorted(p for p in path.rglob("*") if p.is_file())
    return digest({p.relative_to(path).as_posix(): digest(p.read_bytes()) for p in files})
