"""The one store of results: what an experiment has measured is not measured again, whoever was interrupted.

A result is an entry of a folder. Its name is a digest of what it reads, of all modules of the package and of tools, and
of the versions of libraries: a result of other code is never taken.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from importlib.metadata import distributions
from pathlib import Path
from typing import Any, TypeVar

import airgs_codec
from airgs_codec.media.h264 import library_versions
from airgs_codec.places.results import OWN, Store, digest, load, open_store, pack
from airgs_codec.progress import Progress, silent

T = TypeVar("T")
LIBRARIES = ("gsplat", "numba", "numpy", "opencv-contrib-python-headless", "scipy", "torch")  # that decide results


@dataclass(frozen=True, slots=True, eq=False)
class Results:
    store: Store
    progress: Progress = silent

    @staticmethod
    def at(folder: Path, progress: Progress = silent) -> Results:
        """Those of a folder, which is made when it is needed."""
        return Results(open_store(folder), progress=progress)

    def once(self, name: str, reads: Any, make: Callable[[], T]) -> T:
        """The result of this name that was made of `reads`, made now where it is not there.

        `reads`: plain values, arrays, dataclasses and mappings of them, as `digest` takes them; of files `content`.
        The result is a value that `airgs_codec.places.results.pack` takes. Raises what `make` raises, TypeError for
        other `reads`.
        """
        entry = digest(name, code_digest(), _plain(reads))
        found = load(self.store, entry, (*OWN, "tools"))
        if found is None:
            self.progress(name, 0, 1)
            found = (make(),)
            self.store.write(entry, pack(found[0]))
            self.progress(name, 1, 1)
        value: T = found[0]
        return value


@cache
def code_digest() -> str:
    """A digest of the code that makes results, and of what it computes with."""
    folders = Path(airgs_codec.__file__).parent, Path(__file__).parents[1]
    texts = [path.read_bytes() for folder in folders for path in sorted(folder.rglob("*.py"))]
    versions = {one.name: one.version for one in distributions() if one.name in LIBRARIES}
    return digest(texts, versions, library_versions())


def _plain(value: Any) -> Any:
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
