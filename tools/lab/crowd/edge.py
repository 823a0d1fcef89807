"""A cache between the origin and the viewers: least recently used files go first, one fetch for all who wait.

Files of a package never change, so that a cached one is good for ever; airgs.json may change, and the origin is asked
each time whether it has (`no-cache`, RFC 9111).
"""

from __future__ import annotations

import heapq
import math
from array import array
from collections import OrderedDict
from dataclasses import dataclass, field

import numpy as np
from numba import njit
from numpy.typing import NDArray

from airgs_codec.package.layout import ROOTS
from airgs_codec.play.offers import HEADER_BYTES


class LruCache:
    """Files by path, at most `capacity_bytes` together; a larger file is not kept."""

    def __init__(self, capacity_bytes: float) -> None:
        self.capacity_bytes = capacity_bytes
        self.bytes = 0
        self._sizes: OrderedDict[str, int] = OrderedDict()

    def __contains__(self, path: str) -> bool:
        return path in self._sizes

    def has(self, path: str) -> bool:
        """Return whether a file is there; it is now the one last used."""
        if path not in self._sizes:
            return False
        self._sizes.move_to_end(path)
        return True

    def put(self, path: str, size: int) -> None:
        """Keep a file and drop those that were not used for longest."""
        if size > self.capacity_bytes or self.has(path):
            return
        self._sizes[path] = size
        self.bytes += size
        while self.bytes > self.capacity_bytes:
            self.bytes -= self._sizes.popitem(last=False)[1]


class EqualShares:
    """A link whose transfers have equal shares of its capacity at every moment (processor sharing), exactly."""

    def __init__(self, capacity_bps: float) -> None:
        self.capacity_bps = capacity_bps
        self._at_s = 0.0
        self._served = 0.0  # bits that a transfer had that was there from the beginning
        self._ends: list[tuple[float, str]] = []  # by what is served when they are through

    def start(self, name: str, size_bytes: int, at_s: float) -> None:
        """Begin a transfer; times do not go back."""
        self._go_to(at_s)
        heapq.heappush(self._ends, (self._served + 8 * size_bytes, name))

    def next_s(self) -> float:
        """Return when the next transfer ends if none begins before; infinite where there is none."""
        if not self._ends:
            return math.inf
        return self._at_s + max(0.0, self._ends[0][0] - self._served) * len(self._ends) / self.capacity_bps

    def finish(self) -> str:
        """Go to the end of the next transfer; gives its name."""
        self._at_s = self.next_s()
        self._served, name = heapq.heappop(self._ends)
        return name

    def _go_to(self, at_s: float) -> None:
        if self._ends and at_s > self._at_s:
            self._served += (at_s - self._at_s) * self.capacity_bps / len(self._ends)
        self._at_s = max(self._at_s, at_s)


@dataclass(slots=True, eq=False)
class Tally:
    """What an edge was asked for and what it asked the origin for. Bytes are with headers."""

    requests: int = 0
    bytes: int = 0  # of the answers to them
    hits: int = 0
    joined: int = 0  # waited for a fetch that another had caused
    checks: int = 0  # of files that may change: the origin was asked, and sent headers alone
    origin_requests: int = 0  # checks included
    origin_bytes: int = 0

    @property
    def request_hit_rate(self) -> float:
        """Share of requests that caused none to the origin."""
        return 1 - self.origin_requests / max(1, self.requests)

    @property
    def byte_hit_rate(self) -> float:
        """Share of bytes that did not come from the origin for this request."""
        return 1 - self.origin_bytes / max(1, self.bytes)


@dataclass(eq=False)
class Edge:
    """The cache with those who wait for its fetches, and a log of what was asked for."""

    cache: LruCache
    tally: Tally = field(default_factory=Tally)
    log: array[int] = field(default_factory=lambda: array("i"))  # numbers of files that may be cached, in order
    sizes: list[int] = field(default_factory=list)  # bytes of files by number
    _numbers: dict[str, int] = field(default_factory=dict)
    _waiting: dict[str, list[int]] = field(default_factory=dict)
    _seen: set[str] = field(default_factory=set)  # files that may change and are there

    def ask(self, path: str, size: int, viewer: int) -> int | None:
        """A viewer asks for a file of `size` bytes with headers.

        Gives 0 when it is there, None when the viewer must wait for a fetch that is under way, and otherwise the bytes
        that must now be fetched from the origin.
        """
        tally = self.tally
        tally.requests += 1
        tally.bytes += size
        if path in ROOTS:
            return self._ask_root(path, size, viewer)
        if path not in self._numbers:
            self._numbers[path] = len(self.sizes)
            self.sizes.append(size)
        self.log.append(self._numbers[path])
        if self.cache.has(path):
            tally.hits += 1
            return 0
        if path in self._waiting:
            tally.joined += 1
            self._waiting[path].append(viewer)
            return None
        self._waiting[path] = [viewer]
        return self._fetch(size)

    def _ask_root(self, path: str, size: int, viewer: int) -> int | None:
        """Every question goes to the origin; those of the same moment go together."""
        if path in self._waiting:
            self.tally.joined += 1
            self._waiting[path].append(viewer)
            return None
        self._waiting[path] = [viewer]
        if path in self._seen:
            self.tally.checks += 1
            return self._fetch(HEADER_BYTES)
        self._seen.add(path)
        return self._fetch(size)

    def _fetch(self, size: int) -> int:
        self.tally.origin_requests += 1
        self.tally.origin_bytes += size
        return size

    def arrived(self, path: str) -> list[int]:
        """A fetch is over: the file is kept; gives the viewers who wait for it."""
        if path not in ROOTS:
            self.cache.put(path, self.sizes[self._numbers[path]])
        return self._waiting.pop(path)


@njit(cache=True)  # type: ignore[misc, unused-ignore]
def replay(log: NDArray[np.int32], sizes: NDArray[np.int64], capacity: float) -> tuple[int, int]:
    """(requests, bytes) that miss in a cache of `capacity` bytes, least recently used first, over a log of files.

    The cache is empty in the beginning and a fetch takes no time.
    """
    count = len(sizes)
    before, after = np.full(count + 1, -1, np.int64), np.full(count + 1, -1, np.int64)
    before[count] = after[count] = count  # a ring: after the head comes the file last used
    held, misses, missed = 0, 0, 0
    for f in log:
        if before[f] >= 0:
            after[before[f]], before[after[f]] = after[f], before[f]
        else:
            misses, missed = misses + 1, missed + sizes[f]
            if sizes[f] > capacity:
                continue
            held += sizes[f]
        before[f], after[f] = count, after[count]
        before[after[f]] = f
        after[count] = f
        while held > capacity:
            last = before[count]
            before[count], after[before[last]] = before[last], count
            held -= sizes[last]
            before[last] = after[last] = -1
    return misses, missed
