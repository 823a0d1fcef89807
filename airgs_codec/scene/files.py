"""Where the files of a sequence are: on this machine, or below an address, from which they come when they are read."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TypeVar

Read = TypeVar("Read")


class Files:
    """Files of this machine, with which nothing has to be done; what comes from elsewhere overrides all of this."""

    @contextmanager
    def hold(self, paths: Iterable[Path]) -> Iterator[list[Path]]:
        """Gives where files, or frames that are folders, can be read whole until the block ends.

        Raises SceneError where one is gone, TransportError; and renames as `naming` does.
        """
        yield list(paths)

    def read_headers(self, paths: Sequence[Path], read: Callable[[Path], Read]) -> list[Read]:
        """What `read` gives of each frame, which looks no further than its header. Raises what `hold` does."""
        return [read(path) for path in paths]

    def beside(self, path: Path) -> Path | None:
        """Where a file that may lie beside the frames can be read; None where there is none. Raises TransportError."""
        return path if path.is_file() else None

    def name_of(self, path: Path) -> str:
        """A path for people."""
        return str(path)

    @contextmanager
    def naming(self) -> Iterator[None]:
        """A SceneError that the block raises names files for people."""
        yield


LOCAL = Files()
