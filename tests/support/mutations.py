"""Changes to packages, by hand and by chance: the one engine behind the corpus of refusals, the tests and the fuzzer.

A package is held as its files, {relative path: bytes}; a mutation is a function from files to files, which leaves its
argument as it is. `apply` runs some in turn, `on_disk` writes the outcome, `honest` makes the lengths and digests in
airgs.json agree with the files, so that what lies behind the digests is reached.
"""

from __future__ import annotations

import json
import random
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from airgs_codec.package.tables import JSON_NAME, MPD_NAME, digest

Files = dict[str, bytes]
Mutation = Callable[[Files], Files]
Place = tuple[str | int, ...]  # keys and indices from the root of a JSON document
VALUES: list[Any] = [
    None, True, -1, 0, 1, 2, 3, 7, 255, 256, 1 << 16, 1 << 24, 1 << 31, (1 << 31) - 1, 1 << 63, 10**30, -(10**12), 0.5,
    1e-30, 1e30, 1e308, -1e308, "", "x", "../../etc/passwd", "key/T0/1.bin", [], {}, [0], [[0]], [1, 2, 3], {"a": 1},
]  # fmt: skip
NUMBERS = (b"\x00\x00\x00\x00", b"\xff\xff\xff\xff", b"\x7f\xff\xff\xff", b"\x80\x00\x00\x00", b"\x00\x00\x00\x01")


def read_files(folder: Path) -> Files:
    """All files of a package."""
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def apply(files: Files, *mutations: Mutation) -> Files:
    """The files after all mutations, one after another."""
    for mutate in mutations:
        files = mutate(files)
    return files


def on_disk(folder: Path, *mutations: Mutation) -> Path:
    """Mutate the package in `folder` where it lies."""
    before = read_files(folder)
    after = apply(before, *mutations)
    for name in before.keys() - after.keys():
        (folder / name).unlink()
    for name, data in after.items():
        if data != before.get(name):
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_bytes(data)
    return folder


def edit_tables(change: Callable[[dict[str, Any]], object]) -> Mutation:
    """`change` edits the parsed airgs.json in place; what it returns is ignored."""

    def mutate(files: Files) -> Files:
        tables = json.loads(files[JSON_NAME])
        change(tables)
        return files | {JSON_NAME: _compact(tables)}

    return mutate


def set_value(place: Place, value: Any) -> Mutation:
    """Put `value` at a place of airgs.json."""
    return edit_tables(lambda tables: _parent(tables, place).__setitem__(place[-1], value))


def drop_value(place: Place) -> Mutation:
    """Remove a place of airgs.json."""
    return edit_tables(lambda tables: _parent(tables, place).__delitem__(place[-1]))


def places(document: Any, above: Place = ()) -> Iterator[Place]:
    """Every place of a parsed JSON document, the root `()` first."""
    yield above
    items = (
        document.items() if isinstance(document, dict) else enumerate(document if isinstance(document, list) else [])
    )
    for key, inner in items:
        yield from places(inner, (*above, key))


def _compact(tables: Any) -> bytes:
    """JSON as the encoder writes it."""
    return json.dumps(tables, separators=(",", ":")).encode()


def _parent(document: Any, place: Place) -> Any:
    for key in place[:-1]:
        document = document[key]
    return document


def edit_text(name: str, old: str, new: str) -> Mutation:
    """Replace the first occurrence of some text in a file. Raises ValueError where the text is not there."""

    def mutate(files: Files) -> Files:
        text = files[name].decode()
        if old not in text:
            raise ValueError(f"{name}: expected {old!r} in it")
        return files | {name: text.replace(old, new, 1).encode()}

    return mutate


def rewrite(name: str, make: Callable[[bytes], bytes]) -> Mutation:
    """Replace the bytes of a file; its entry in airgs.json stays as it was."""
    return lambda files: files | {name: make(files[name])}


def add_file(name: str, data: bytes) -> Mutation:
    """A file more, which no table lists."""
    return lambda files: files | {name: data}


def remove_file(name: str) -> Mutation:
    """A file less; its entry in airgs.json stays."""
    return lambda files: {other: data for other, data in files.items() if other != name}


def honest(files: Files) -> Files:
    """Give every listed file its length and digest; files with tables that cannot be read stay as they are."""
    try:
        tables = json.loads(files[JSON_NAME])
    except (ValueError, RecursionError):
        return files
    if not isinstance(tables, dict) or not isinstance(tables.get("files"), dict):
        return files
    for name, entry in tables["files"].items():
        if name in files and isinstance(entry, dict):
            entry |= {"bytes": len(files[name]), "sha256": digest(files[name])}
    return files | {JSON_NAME: _compact(tables)}


def by_chance(chance: random.Random, *, tables: bool = True) -> Mutation:
    """One random change to one file; `tables`: airgs.json and manifest.mpd are among them, and more often."""

    def mutate(files: Files) -> Files:
        names = [name for name in files if tables or name not in (JSON_NAME, MPD_NAME)]
        often = (JSON_NAME, MPD_NAME) if tables else names
        name = chance.choice(names) if chance.random() < 0.7 else chance.choice(often)
        if name == JSON_NAME and chance.random() < 0.8:
            return files | {name: random_tables(chance, files[name])}
        return files | {name: random_bytes(chance, files[name], chance.choice([d for d in files.values() if d]))}

    return mutate


def random_bytes(chance: random.Random, data: bytes, other: bytes) -> bytes:
    """One change: bits, bytes, numbers, pieces cut, doubled, cut short or taken from another file."""
    if not data:
        return data
    at = chance.randrange(len(data))
    head, piece, tail = data[:at], data[at : at + (1 << chance.randrange(1, 7))], data[at:]
    rest = data[at + len(piece) :]
    start = chance.randrange(len(other))
    match chance.randrange(8):
        case 0:
            return _flip_bits(chance, data)
        case 1:
            return head + bytes([chance.randrange(256)]) + tail[1:]
        case 2:
            return head + chance.choice(NUMBERS) + tail[4:]
        case 3:
            return head + rest
        case 4:
            return head + piece + tail
        case 5:
            return head
        case 6:
            return head + other[start : start + len(piece)] + rest
        case _:
            return head + chance.randbytes(len(piece)) + tail


def _flip_bits(chance: random.Random, data: bytes) -> bytes:
    out = bytearray(data)
    for _ in range(chance.choice((1, 1, 2, 8))):
        out[chance.randrange(len(out))] ^= 1 << chance.randrange(8)
    return bytes(out)


def random_tables(chance: random.Random, text: bytes) -> bytes:
    """One or two values somewhere in the tables replaced, dropped, doubled or moved a little."""
    try:
        tables = json.loads(text)
    except (ValueError, RecursionError):
        return text
    for _ in range(chance.choice((1, 1, 1, 2))):
        _change_somewhere(chance, tables)
    return json.dumps(tables).encode()


def _change_somewhere(chance: random.Random, here: Any) -> None:
    """Walk down at random and change one value; an empty document stays as it is."""
    while isinstance(here, (dict, list)) and here:
        key = chance.choice(list(here) if isinstance(here, dict) else range(len(here)))
        if not (isinstance(here[key], (dict, list)) and here[key] and chance.random() < 0.85):
            _change(chance, here, key)
            return
        here = here[key]


def _change(chance: random.Random, here: Any, key: Any) -> None:
    value, kind = here[key], chance.randrange(5)
    if kind == 0:
        del here[key]
    elif kind == 1 and isinstance(here, list):
        here.insert(key, value)
    elif kind == 2 and isinstance(value, (int, float)):
        here[key] = value + chance.choice((-1, 1, 16, 256, -value, value))
    elif kind == 3 and isinstance(value, str) and value:
        here[key] = value[:-1] + chance.choice("xA0/")
    else:
        here[key] = chance.choice(VALUES)
