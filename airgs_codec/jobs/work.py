"""Calls of one function, done by an executor or here, with results stored by the name of all that they read."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import BrokenExecutor, Executor, as_completed
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from airgs_codec.errors import WorkError
from airgs_codec.places.results import Store, digest, load, open_store, pack
from airgs_codec.progress import Progress, silent


@dataclass(frozen=True, slots=True, eq=False)
class Work:
    executor: Executor | None = None  # None: this process
    store: Store | None = None  # of results that are found again; None: nothing is stored
    progress: Progress = silent

    @staticmethod
    def of(executor: Executor | None, place: str | Path | None, progress: Progress) -> Work:
        """Open the store at a place, where there is one. Raises ConfigError as `open_store` does."""
        return Work(executor, None if place is None else open_store(place), progress)

    @property
    def elsewhere(self) -> bool:
        """Whether calls are done by others, or their results stored."""
        return self.executor is not None or self.store is not None

    def results(self, *what: Any) -> list[Any]:
        """Give the results of `map` in the order of the calls."""
        return [value for _, value in sorted(self.map(*what), key=lambda found: found[0])]

    def map(
        self,
        stage: str,
        function: Callable[..., Any],
        calls: Sequence[tuple[Any, ...]],
        contents: Sequence[Any] | None = None,
        version: int = 0,
    ) -> Iterator[tuple[int, Any]]:
        """Call a function with each tuple of arguments; yield the place of a call and its result when it is there.

        A result is stored by the name of the function, its `version`, and what the call reads, of which `contents` say
        what decides; without them nothing is stored. Raises what a call raises first, and WorkError where workers die.
        """
        entries: list[str | None] = [None] * len(calls)
        if self.store and contents is not None:
            entries = [_name(function, content, version) for content in contents]
        left: list[int] = []
        done = 0
        for place, entry in enumerate(entries):
            found = load(self.store, entry) if self.store and entry else None
            if found is None:
                left.append(place)
                continue
            done += 1
            yield place, found[0]
        for place, value in self._finish(function, {place: calls[place] for place in left}, entries):
            done += 1
            self.progress(stage, done, len(calls))
            yield place, value

    def stored(self, function: Callable[..., Any], contents: Sequence[Any], version: int = 0) -> list[Any]:
        """Give those results of `map` that are there already."""
        names = [_name(function, content, version) for content in contents] if self.store else []
        return [found[0] for name in names if self.store and (found := load(self.store, name))]

    def _finish(
        self, function: Callable[..., Any], calls: dict[int, tuple[Any, ...]], entries: Sequence[str | None]
    ) -> Iterator[tuple[int, Any]]:
        if self.executor is None:
            yield from ((place, _call(self.store, entries[place], function, *call)) for place, call in calls.items())
            return
        futures = {
            self.executor.submit(_call, self.store, entries[place], function, *call): place
            for place, call in calls.items()
        }
        try:
            for future in as_completed(futures):
                yield futures[future], future.result()
        except BrokenExecutor as error:
            raise WorkError(f"workers died, is there memory for them? ({error})") from error
        finally:
            for future in futures:
                future.cancel()


def _name(function: Callable[..., Any], content: Any, version: int) -> str:
    return digest(function.__module__, function.__qualname__, version, content)


def _call(store: Store | None, entry: str | None, function: Callable[..., Any], *arguments: Any) -> Any:
    """Do a call and store its result: what a worker does."""
    value = function(*arguments)
    if store and entry:
        store.write(entry, pack(value))
    return value
