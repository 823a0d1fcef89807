"""Finished work by name, in any place that all who share it can reach.

An entry is whole or absent: the SHA-256 of its name and the rest, then bytes; one that does not fit its digest, damaged
or another's, is removed when it is read, and said. The bytes of a value are JSON and arrays. Reading them constructs
plain values, numpy arrays and dataclasses of packages that the reader trusts, and runs nothing else; so a store that
others can write to may give wrong results, but runs none of their code.
"""

from __future__ import annotations

import dataclasses
import hashlib
import importlib
import io
import json
import logging
import types
import typing
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import accumulate, pairwise
from pathlib import Path
from tokenize import TokenError
from typing import Any

import numpy as np

from airgs_codec.errors import ConfigError
from airgs_codec.places.place import Folder, Place, is_address, place_at

DIGEST_BYTES = 32
OWN = ("airgs_codec",)  # packages whose dataclasses are read
_LENGTH_BYTES = 8  # of the JSON text, before it
_log = logging.getLogger(__name__)
_BROKEN = (
    *(ValueError, TypeError, LookupError, AttributeError, ArithmeticError, ImportError, EOFError, RecursionError),
    *(SyntaxError, TokenError, MemoryError),  # of the header of an array
)


@dataclass(frozen=True, slots=True)
class Store:
    """Entries by name, which workers in other processes and on other machines see as well; it can be pickled.

    All methods raise OSError (TransportError) where the place fails.
    """

    place: Place

    def read(self, entry: str) -> bytes | None:
        """Return the bytes of an entry; None where there is none that is whole."""
        sealed = self.place.read(_path(entry))
        data = None if sealed is None else unseal(entry, sealed)
        if sealed is not None and data is None:
            self.discard(entry)
        return data

    def discard(self, entry: str) -> None:
        """Delete an entry that cannot be used, and say so."""
        _log.warning("%s: the stored result %s is damaged or another's, and is made again", self.place.name, entry[:12])
        self.place.delete([_path(entry)])

    def write(self, entry: str, data: bytes) -> None:
        """Put an entry, whole or not at all; one of the same name is replaced."""
        self.place.write(_path(entry), seal(entry, data))


def open_store(place: str | Path) -> Store:
    """Return the store at a folder or an address. Raises ConfigError where there is a file, and for a bad address."""
    if is_address(place):
        return Store(place_at(place))
    path = Path(place)
    if path.exists() and not path.is_dir():
        raise ConfigError(f"{place}: expected a folder for work, got a file")
    return Store(Folder(path))


def load(store: Store, entry: str, trusted: tuple[str, ...] = OWN) -> tuple[Any] | None:
    """Read a stored value; None where there is none, which a value of None is not.

    One that is no value, or of a dataclass that is no more, is removed, and said. `trusted` is as in `unpack`.
    """
    data = store.read(entry)
    try:
        return None if data is None else (unpack(data, trusted),)
    except ValueError:
        store.discard(entry)
        return None


def digest(*values: Any) -> str:
    """Compute the SHA-256 of plain values, arrays, and dataclasses, sequences and mappings of them, in hexadecimal.

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


def _path(entry: str) -> str:
    return f"{entry[:2]}/{entry}"


def seal(entry: str, data: bytes) -> bytes:
    return hashlib.sha256(entry.encode() + b"\n" + data).digest() + data


def unseal(entry: str, sealed: bytes) -> bytes | None:
    """Return the bytes of a stored entry; None where they are damaged, or those of another one."""
    data = sealed[DIGEST_BYTES:]
    return data if seal(entry, data) == sealed else None


def pack(value: Any) -> bytes:
    """Return the bytes of a value: the length of a JSON text, the text, and the arrays (.npy) and bytes that it names.

    Raises TypeError for what is no plain value, sequence, mapping, array, or dataclass of them that a module has.
    """
    packer = _Packer()
    plain = packer.plain(value)
    text = json.dumps({"value": plain, "sizes": [len(part) for part in packer.parts]}).encode()
    return b"".join([len(text).to_bytes(_LENGTH_BYTES, "little"), text, *packer.parts])


def unpack(data: bytes, trusted: tuple[str, ...] = OWN) -> Any:
    """Return the value of the bytes that `pack` gave. Arrays are new and can be written to.

    `trusted`: top packages whose dataclasses may be constructed. Raises ValueError for anything else.
    """
    try:
        start = _LENGTH_BYTES + int.from_bytes(data[:_LENGTH_BYTES], "little")
        found = json.loads(data[_LENGTH_BYTES:start])
        bounds = list(accumulate(found["sizes"], initial=start))
        parts = [data[begin:end] for begin, end in pairwise(bounds)]
        return _value(found["value"], parts, trusted)
    except _BROKEN as error:
        raise ValueError(f"expected a stored value, got {type(error).__name__}: {error}") from error


class _Packer:
    """JSON of one value. Objects of JSON have one name, which says what they stand for."""

    def __init__(self) -> None:
        self.parts: list[bytes] = []
        self._known: dict[int, tuple[np.ndarray, int]] = {}  # by identity: they stay alive

    def plain(self, value: Any) -> Any:
        """Return what stands for a value in JSON."""
        if value is None or type(value) in (bool, int, float, str):
            return value
        if type(value) is list:
            return [self.plain(part) for part in value]
        if type(value) is tuple:
            return {"tuple": [self.plain(part) for part in value]}
        if type(value) is dict:
            return {"dict": [[self.plain(name), self.plain(part)] for name, part in value.items()]}
        if type(value) is bytes:
            return {"bytes": self._add(value)}
        if isinstance(value, np.ndarray):
            return {"array": self._add_array(value)}
        if isinstance(value, np.generic):
            return {"scalar": self._add_array(np.asarray(value))}
        if isinstance(value, Fraction):
            return {"fraction": str(value)}
        if isinstance(value, Path):
            return {"path": str(value)}
        kind = type(value)
        if dataclasses.is_dataclass(kind) and "<" not in kind.__qualname__:
            fields = {f.name: self.plain(getattr(value, f.name)) for f in dataclasses.fields(kind) if f.init}
            return {"is": f"{kind.__module__}:{kind.__qualname__}", "of": fields}
        raise TypeError(f"expected plain values, arrays or dataclasses, got {kind.__qualname__}")

    def _add(self, part: bytes) -> int:
        self.parts.append(part)
        return len(self.parts) - 1

    def _add_array(self, array: np.ndarray) -> int:
        if array.dtype.hasobject:
            raise TypeError(f"expected an array of numbers or text, got {array.dtype}")
        if id(array) not in self._known:
            file = io.BytesIO()
            np.lib.format.write_array(file, array, allow_pickle=False)
            self._known[id(array)] = array, self._add(file.getvalue())
        return self._known[id(array)][1]


def _value(plain: Any, parts: list[bytes], trusted: tuple[str, ...]) -> Any:
    if isinstance(plain, list):
        return [_value(part, parts, trusted) for part in plain]
    if not isinstance(plain, dict):
        return plain
    (kind, found), *rest = plain.items()
    if kind == "tuple":
        return tuple(_value(part, parts, trusted) for part in found)
    if kind == "dict":
        return {_value(name, parts, trusted): _value(part, parts, trusted) for name, part in found}
    if kind == "bytes":
        return parts[found]
    if kind in ("array", "scalar"):
        array = np.lib.format.read_array(io.BytesIO(parts[found]), allow_pickle=False)
        return array if kind == "array" else array[()]
    if kind == "fraction":
        return Fraction(*map(int, found.split("/")))  # of powers of ten Fraction would write out all digits
    if kind == "path":
        return Path(found)
    if kind != "is":
        raise ValueError(f"unknown kind {kind}")
    fields = {name: _value(part, parts, trusted) for name, part in dict(rest)["of"].items()}
    made = _dataclass(found, trusted)
    for name, hint in typing.get_type_hints(made).items():
        if name in fields and not _fits(fields[name], hint):
            raise ValueError(f"{found}.{name}: expected {hint}, got {type(fields[name]).__name__}")
    return made(**fields)


def _fits(value: Any, hint: Any) -> bool:
    """Whether a value is of an annotated type, as far as those of stored values go."""
    kind, arguments = typing.get_origin(hint) or hint, typing.get_args(hint)
    if kind in (typing.Union, types.UnionType):
        return any(_fits(value, one) for one in arguments)
    if kind in (float, int):
        return isinstance(value, (kind, int, np.integer, np.floating))
    if kind is Any or not isinstance(kind, type) or getattr(kind, "_is_protocol", False):
        return True
    if not isinstance(value, kind):
        return False
    if isinstance(value, Mapping):
        return all(_fits(name, arguments[0]) and _fits(part, arguments[1]) for name, part in value.items())
    if isinstance(value, Sequence) and arguments and kind is not tuple:
        return all(_fits(part, arguments[0]) for part in value)
    return True


def _dataclass(name: str, trusted: tuple[str, ...]) -> type:
    """Return the dataclass of a name. Raises ValueError for anything that is no dataclass of a trusted package."""
    module, _, qualified = name.partition(":")
    if module.partition(".")[0] not in trusted:
        raise ValueError(f"{name} is of no package that is trusted")
    found: Any = importlib.import_module(module)
    for part in qualified.split("."):
        found = getattr(found, part)
    if not isinstance(found, type) or not dataclasses.is_dataclass(found) or found.__module__ != module:
        raise ValueError(f"{name} is no dataclass")
    return found
