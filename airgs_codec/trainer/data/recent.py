"""Values that are made when they are asked for, of which those used last stay in memory, up to a number of bytes."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable
from concurrent.futures import ThreadPoolExecutor
from typing import Generic, Protocol, TypeVar


class Sized(Protocol):
    """What takes memory."""

    @property
    def nbytes(self) -> int:
        """The memory that it takes, in bytes."""


Key = TypeVar("Key", bound=Hashable)
Value = TypeVar("Value", bound=Sized)


class Recent(Generic[Key, Value]):
    """The values used last. Several threads may ask; values are made one at a time."""

    def __init__(self, make: Callable[[Key], Value], most: int) -> None:
        """`most`: bytes that stay together; the value that was asked for last stays whatever it takes."""
        self._make = make
        self._most = most
        self._values: OrderedDict[Key, Value] = OrderedDict()
        self._making = threading.Lock()
        self._changing = threading.Lock()
        self._thread: ThreadPoolExecutor | None = None

    @property
    def nbytes(self) -> int:
        """Return the bytes of the values in memory now."""
        with self._changing:
            return sum(value.nbytes for value in self._values.values())

    def __contains__(self, key: Key) -> bool:
        with self._changing:
            return key in self._values

    def get(self, key: Key) -> Value:
        """Return the value of a key. Raises what making it raises."""
        found = self._find(key)
        if found is not None:
            return found
        with self._making:
            found = self._find(key)  # somebody may have made it meanwhile
            return self.put(key, self._make(key)) if found is None else found

    def expect(self, key: Key) -> None:
        """Make the value of a key in another thread, where it is not in memory; a failure is left for `get` to find."""
        if key not in self:
            if self._thread is None:
                self._thread = ThreadPoolExecutor(1)
            self._thread.submit(self.get, key)

    def _find(self, key: Key) -> Value | None:
        with self._changing:
            if key in self._values:
                self._values.move_to_end(key)
            return self._values.get(key)

    def put(self, key: Key, value: Value) -> Value:
        """Hold a value that is known already, and return it."""
        with self._changing:
            self._values[key] = value
            held = sum(v.nbytes for v in self._values.values())
            while held > self._most and len(self._values) > 1:
                held -= self._values.popitem(last=False)[1].nbytes
        return value
