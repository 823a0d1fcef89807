"""Jobs: a function of this package, what it reads, and the name of its result; and what a worker does with one.

Equal values have equal names on every machine and in every process. The name of a result also holds the code that makes
it: the modules that its function's module imports, directly or not, and the versions of the libraries that they use.
"""

from __future__ import annotations

import dataclasses
import hashlib
import importlib.metadata
import json
import os
import platform
import re
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from airgs_codec.errors import WorkError
from airgs_codec.jobs.engines import NOTHING, Needs
from airgs_codec.media.h264 import library_versions
from airgs_codec.places.results import OWN, Store, pack, unpack

LIBRARIES = {  # modules that are imported -> distributions whose versions decide results
    "cv2": "opencv-contrib-python-headless", "gsplat": "gsplat", "numba": "numba", "numpy": "numpy",
    "scipy": "scipy", "torch": "torch",
}  # fmt: skip
_TYPES_ONLY = re.compile(r"^if TYPE_CHECKING:\n(?:[ \t]+.*\n|\n)+", re.MULTILINE)
_IMPORT = re.compile(r"^[ \t]*(?:from (\S+) import (\([^)]*\)|.*)|import (.*))$", re.MULTILINE)


def digest(*values: Any) -> str:
    """SHA-256 of plain values, arrays, and dataclasses, sequences and mappings of them, as hexadecimal digits.

    Raises TypeError for anything else: what has no content that can be told apart must not name a result.
    """
    h = hashlib.sha256()
    for value in values:
        _add(h, value)
    return h.hexdigest()


def _add(h: hashlib._Hash, value: Any) -> None:
    if isinstance(value, np.ndarray):
        h.update(f"array {value.dtype.str} {value.shape} ".encode())
        h.update(np.ascontiguousarray(value).data)
    elif value is None or isinstance(value, str | bytes | bool | int | float | Fraction | np.generic):
        text = repr(value).encode()
        h.update(f"{type(value).__name__} {len(text)} ".encode() + text)
    elif dataclasses.is_dataclass(value) and not isinstance(value, type):
        h.update(f"{type(value).__qualname__} ".encode())
        for field in dataclasses.fields(value):
            _add(h, getattr(value, field.name))
    elif isinstance(value, tuple | list):
        h.update(f"sequence {len(value)} ".encode())
        for part in value:
            _add(h, part)
    elif isinstance(value, Mapping):
        h.update(f"mapping {len(value)} ".encode())
        for name in sorted(value):
            _add(h, name)
            _add(h, value[name])
    else:
        raise TypeError(f"expected plain values, arrays or dataclasses, got {type(value).__qualname__}")


def code_digest(function: Callable[..., Any]) -> str:
    """SHA-256 of the code that a function may run, and of the versions of what it computes with.

    That is its module and all that this imports, directly or not, of the package that it is in and of this one.
    """
    return _digest_of_module(module_name(function))


def module_name(function: Callable[..., Any]) -> str:
    """Return the module of a function, by the name that others import it by; of a partial, its function's."""
    while isinstance(function, partial):
        function = function.func
    name = function.__module__
    spec = sys.modules["__main__"].__spec__ if name == "__main__" else None
    return spec.name if spec is not None else name


@cache
def _digest_of_module(name: str) -> str:
    h = hashlib.sha256()
    used: set[str] = set()
    for module, path in sorted(modules_run(name).items()):
        text = path.read_text(encoding="utf-8")
        used.update(found.partition(".")[0] for found in _imports(text))
        h.update(f"{module} {len(text)} {text}".encode())
    versions = {library: _version(library) for library in sorted(LIBRARIES.keys() & used)}
    h.update(json.dumps([versions, library_versions() if "av" in used else None], sort_keys=True).encode())
    return h.hexdigest()


def modules_run(name: str) -> dict[str, Path]:
    """The file of a module and of every module that it imports, directly or not, of its package and of this one."""
    roots = {top: _folder(top) for top in {name.partition(".")[0], "airgs_codec"}}
    found: dict[str, Path] = {}
    todo = [name]
    while todo:
        module = todo.pop()
        top, *inner = module.split(".")
        if top not in roots or module in found:
            continue
        if (path := _file(roots[top].joinpath(*inner))) is None:
            continue  # no module, but a name in one
        found[module] = path
        todo.append(module.rpartition(".")[0])
        todo.extend(_imports(path.read_text(encoding="utf-8")))
    return found


def _folder(top: str) -> Path:
    """The folder of a package that is imported; of a script, which is none, a folder without modules."""
    module = sys.modules.get(top) or importlib.import_module(top)
    paths = list(getattr(module, "__path__", []))
    return Path(paths[0]) if paths else Path(getattr(module, "__file__", None) or top).with_suffix("")


def _file(stem: Path) -> Path | None:
    return next((path for path in (stem.with_suffix(".py"), stem / "__init__.py") if path.is_file()), None)


def _imports(text: str) -> Iterator[str]:
    """Names of modules that a text imports for more than types, and of what it imports from them."""
    for module, names, modules in _IMPORT.findall(_TYPES_ONLY.sub("", text)):
        each = [part.split()[0] for part in re.sub(r"#.*|[()]", "", modules or names).split(",") if part.strip()]
        yield from each if modules else [module, *(f"{module}.{name}" for name in each)]


def _version(library: str) -> str | None:
    try:
        return importlib.metadata.version(LIBRARIES[library])
    except importlib.metadata.PackageNotFoundError:
        return None


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
    if job.code and job.code != code_digest(job.function):
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

    One that is no value, or of a dataclass that is no more, is removed, and said. `trusted` as
    `places.results.unpack` takes it.
    """
    data = store.read(entry)
    try:
        return None if data is None else (unpack(data, trusted),)
    except ValueError:
        store.discard(entry)
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
