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
from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from itertools import accumulate, chain, pairwise
from pathlib import Path
from typing import Any

import numpy as np

from airgs_codec.errors import ConfigError
from airgs_codec.places.place import Folder, Storage, is_address, place_at
from airgs_codec.places.whole import BROKEN

DIGEST_BYTES = 32
OWN = ("airgs_codec",)  # packages whose dataclasses are read
_LENGTH_BYTES = 8  # of the JSON text, before it
_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Store:
    """Entries by name, which other processes see as well; it can be pickled. Methods raise OSError (TransportError)."""

    place: Storage

    def read(self, entry: str) -> bytes | None:
        """Return the bytes of an entry; None where there is none that is whole."""
        if (sealed := self.place.read(_path(entry))) is None:
            return None
        if (data := unseal(entry, sealed)) is None:
            self.discard(entry)
        return data

    def discard(self, entry: str) -> None:
        _log.warning("%s: the stored result %s is damaged or another's, and is made again", self.place.name, entry[:12])
        self.place.delete([_path(entry)])

    def write(self, entry: str, data: bytes) -> None:
        self.place.write(_path(entry), seal(entry, data))


def open_store(place: str | Path) -> Store:
    """Return the store at a folder or an address. Raises ConfigError."""
    if is_address(place):
        return Store(place_at(place))
    path = Path(place)
    if path.exists() and not path.is_dir():
        raise ConfigError(f"{place}: expected a folder for work, got a file")
    return Store(Folder(path))


def load(store: Store, entry: str, trusted: tuple[str, ...] = OWN) -> tuple[Any] | None:
    """Return a stored value in a tuple; None where there is none. One that cannot be read is removed."""
    data = store.read(entry)
    try:
        return None if data is None else (unpack(data, trusted),)
    except ValueError:
        store.discard(entry)
        return None


def digest(*values: Any) -> str:
    """Return the SHA-256 of plain values, arrays, and dataclasses, sequences and mappings of them. Raises TypeError."""
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
    elif isinstance(value, tuple | list | Mapping):
        parts = chain(*((name, value[name]) for name in sorted(value))) if isinstance(value, Mapping) else value
        h.update(f"{'mapping' if isinstance(value, Mapping) else 'sequence'} {len(value)} ".encode())
        for part in parts:
            _add(h, part)
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
    """Return the length of a JSON text, the text, and the arrays (.npy) and bytes that it names.

    Raises TypeError for what is no plain value, sequence, mapping, array, or dataclass of them that a module has.
    """
    parts: list[bytes] = []
    plain = _plain(value, parts)
    text = json.dumps({"value": plain, "sizes": [len(part) for part in parts]}).encode()
    return b"".join([len(text).to_bytes(_LENGTH_BYTES, "little"), text, *parts])


def _plain(value: Any, parts: list[bytes]) -> Any:
    """Return what stands for a value in JSON, whose objects have one name, which says what they stand for."""
    kind = type(value)
    if value is None or kind in (bool, int, float, str):
        return value
    if kind is list:
        return [_plain(part, parts) for part in value]
    if kind is tuple:
        return {"tuple": [_plain(part, parts) for part in value]}
    if kind is dict:
        return {"dict": [[_plain(name, parts), _plain(part, parts)] for name, part in value.items()]}
    if kind is bytes:
        parts.append(value)
        return {"bytes": len(parts) - 1}
    if isinstance(value, np.ndarray | np.generic) and not value.dtype.hasobject:
        file = io.BytesIO()
        np.lib.format.write_array(file, np.asanyarray(value), allow_pickle=False)
        parts.append(file.getvalue())
        return {"array" if isinstance(value, np.ndarray) else "scalar": len(parts) - 1}
    if isinstance(value, Fraction | Path):
        return {"fraction" if isinstance(value, Fraction) else "path": str(value)}
    if dataclasses.is_dataclass(kind) and "<" not in kind.__qualname__:
        fields = {f.name: _plain(getattr(value, f.name), parts) for f in dataclasses.fields(kind) if f.init}
        return {"is": f"{kind.__module__}:{kind.__qualname__}", "of": fields}
    raise TypeError(f"expected plain values, arrays or dataclasses, got {kind.__qualname__}")


def unpack(data: bytes, trusted: tuple[str, ...] = OWN) -> Any:
    """Return the value of the bytes that `pack` gave; arrays are new. Raises ValueError.

    `trusted`: top packages whose dataclasses may be constructed.
    """
    try:
        start = _LENGTH_BYTES + int.from_bytes(data[:_LENGTH_BYTES], "little")
        found = json.loads(data[_LENGTH_BYTES:start])
        parts = [data[begin:end] for begin, end in pairwise(accumulate(found["sizes"], initial=start))]
        return _value(found["value"], parts, trusted)
    except BROKEN as error:
        raise ValueError(f"expected a stored value, got {type(error).__name__}: {error}") from error


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
    return _dataclass(found, trusted)(**fields)


def _dataclass(name: str, trusted: tuple[str, ...]) -> type:
    module, _, qualified = name.partition(":")
    if module.partition(".")[0] not in trusted:
        raise ValueError(f"{name} is of no package that is trusted")
    found: Any = importlib.import_module(module)
    for part in qualified.split("."):
        found = getattr(found, part)
    if not isinstance(found, type) or not dataclasses.is_dataclass(found) or found.__module__ != module:
        raise ValueError(f"{name} is no dataclass")
    return found
