"""Calls of one function, done by an executor or here, with results stored by the name of all that they read."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
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
        """Return work with the store at a place, if any. Raises ConfigError as `open_store` does."""
        return Work(executor, None if place is None else open_store(place), progress)

    @property
    def elsewhere(self) -> bool:
        """Return whether other processes do the calls, or their results are stored."""
        return self.executor is not None or self.store is not None

    def results(self, *what: Any) -> list[Any]:
        """Return the results of `map` in the order of the calls."""
        return [value for _, value in sorted(self.map(*what), key=lambda found: found[0])]

    def map(
        self,
        stage: str,
        function: Callable[..., Any],
        calls: Sequence[tuple[Any, ...]],
        contents: Sequence[Any] | None = None,
        version: int = 0,
    ) -> Iterator[tuple[int, Any]]:
        """Call a function with each tuple of arguments; yield the index of each call and its result, as they finish.

        A result is stored by the name of the function, its `version`, and what the call reads, of which `contents` say
        what decides; without them nothing is stored. Raises what a call raises first, and WorkError where workers die.
        """
        names: Sequence[str | None] = self._names(function, contents or (), version) or [None] * len(calls)
        left = {}
        for place, (name, call) in enumerate(zip(names, calls, strict=True)):
            if self.store and name and (found := load(self.store, name)):
                yield place, found[0]
            else:
                left[place] = (self.store, name, function, *call)
        for done, (place, value) in enumerate(self._finish(left), len(calls) - len(left) + 1):
            self.progress(stage, done, len(calls))
            yield place, value

    def stored(self, function: Callable[..., Any], contents: Sequence[Any], version: int = 0) -> list[Any]:
        """Return those results of `map` that are stored already."""
        names = self._names(function, contents, version)
        return [found[0] for name in names if self.store and (found := load(self.store, name))]

    def _names(self, function: Callable[..., Any], contents: Sequence[Any], version: int) -> list[str]:
        named = function.__module__, function.__qualname__, version
        return [digest(*named, content) for content in contents] if self.store else []

    def _finish(self, calls: Mapping[int, tuple[Any, ...]]) -> Iterator[tuple[int, Any]]:
        if self.executor is None:
            yield from ((place, _call(*call)) for place, call in calls.items())
            return
        futures = {self.executor.submit(_call, *call): place for place, call in calls.items()}
        try:
            for future in as_completed(futures):
                yield futures[future], future.result()
        except BrokenExecutor as error:
            raise WorkError(f"workers died, is there memory for them? ({error})") from error
        finally:
            for future in futures:
                future.cancel()


def _call(store: Store | None, entry: str | None, function: Callable[..., Any], *arguments: Any) -> Any:
    """Do a call in a worker and store its result."""
    value = function(*arguments)
    if store and entry:
        store.write(entry, pack(value))
    return value
