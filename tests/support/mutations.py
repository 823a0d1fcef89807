"""Changes to packages, by hand and by chance: the one engine behind the corpus of refusals, the tests and the fuzzer.

A package is held as its files, {relative path: bytes}; a mutation is a function from files to files, which leaves its
argument as it is. `apply` runs some in turn, `on_disk` writes the outcome, `honest` makes the lengths and digests in
the tables agree with the files, so that what lies behind the digests is reached.
"""

from __future__ import annotations

import gzip
import itertools
import json
import os
import random
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from airgs_codec.package.paths import (
    INIT_NAME,
    JSON_NAME,
    MPD_NAME,
    FileKind,
    file_kind,
    group_path,
    key_media_path,
    key_sidecar_path,
    state_media_path,
    tile_folder,
)
from airgs_codec.package.tables import digest

Files = dict[str, bytes]
Mutation = Callable[[Files], Files]
Place = tuple[str | int, ...]  # keys and indices from the root of a JSON document
VALUES: list[Any] = [
    None, True, -1, 0, 1, 2, 3, 7, 255, 256, 1 << 16, 1 << 24, 1 << 31, (1 << 31) - 1, 1 << 63, 10**30, -(10**12), 0.5,
    1e-30, 1e30, 1e308, -1e308, "", "x", "../../etc/passwd", "A" * 32, [], {}, [0], [[0]], [1, 2, 3], {"a": 1},
]  # fmt: skip
NUMBERS = (b"\x00\x00\x00\x00", b"\xff\xff\xff\xff", b"\x7f\xff\xff\xff", b"\x80\x00\x00\x00", b"\x00\x00\x00\x01")


class Link(bytes):
    """In place of the bytes of a file: a symbolic link, and where it leads."""


def read_files(folder: Path) -> Files:
    """All files of a package."""
    found = {p.relative_to(folder).as_posix(): p for p in sorted(folder.rglob("*")) if p.is_file()}
    return {
        name: Link(os.readlink(path).encode()) if path.is_symlink() else path.read_bytes()
        for name, path in found.items()
    }


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
    return write_files(folder, {name: data for name, data in after.items() if data != before.get(name)})


def write_files(folder: Path, files: Files) -> Path:
    """Write these files below `folder`, where others stay as they are."""
    for name, data in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.unlink(missing_ok=True)
        if isinstance(data, Link):
            path.symlink_to(data.decode())
        else:
            path.write_bytes(data)
    return folder


def edit_tables(change: Callable[[dict[str, Any]], object], name: str = JSON_NAME) -> Mutation:
    """`change` edits a parsed table in place; what it returns is ignored. The index does not learn of it."""

    def mutate(files: Files) -> Files:
        table = parse_table(files[name])
        change(table)
        return files | {name: pack_table(name, table)}

    return mutate


def set_value(place: Place, value: Any, name: str = JSON_NAME) -> Mutation:
    """Put `value` at a place of a table."""
    return edit_tables(lambda table: _parent(table, place).__setitem__(place[-1], value), name)


def drop_value(place: Place, name: str = JSON_NAME) -> Mutation:
    """Remove a place of a table."""
    return edit_tables(lambda table: _parent(table, place).__delitem__(place[-1]), name)


def parse_table(data: bytes) -> Any:
    """The JSON of a table, with or without gzip."""
    return json.loads(gzip.decompress(data) if data[:2] == b"\x1f\x8b" else data)


def pack_table(name: str, table: Any) -> bytes:
    """The bytes of a table of this name."""
    text = json.dumps(table, separators=(",", ":")).encode()
    return gzip.compress(text, 9, mtime=0) if name.endswith(".gz") else text


def places(document: Any, above: Place = ()) -> Iterator[Place]:
    """Every place of a parsed JSON document, the root `()` first."""
    yield above
    items = (
        document.items() if isinstance(document, dict) else enumerate(document if isinstance(document, list) else [])
    )
    for key, inner in items:
        yield from places(inner, (*above, key))


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


def link_file(name: str, target: str) -> Mutation:
    """A symbolic link in place of a file."""
    return lambda files: files | {name: Link(target.encode())}


def honest(files: Files) -> Files:
    """Give every listed file its length and digest, up to the root; what cannot be read stays as it is."""
    out, segment = dict(files), 1
    for number in itertools.count(1):
        name = group_path(number)
        if name not in out:
            break
        try:
            table = parse_table(out[name])
            for path, entry in _entries(table, number, segment):
                if path in out and entry["bytes"]:
                    entry |= {"bytes": len(out[path]), "sha256": digest(out[path])}
            segment += len(table["segments"])
            out[name] = pack_table(name, table)
        except UNREADABLE:
            continue
    return reindexed(out)


UNREADABLE = (ValueError, KeyError, TypeError, IndexError, RecursionError, OSError, EOFError, zlib.error)


def _entries(table: Any, number: int, segment: int) -> Iterator[tuple[str, Any]]:
    """Path and entry of every file of a group, whose first segment has the number `segment`."""
    count = len(table["tiles"])
    for p, tile in enumerate(table["tiles"]):
        for t, tier in enumerate(tile["tiers"]):
            yield key_sidecar_path(tile_folder(p, count), t, number), tier["sidecar"]
            for q, entry in enumerate(tier["pictures"]):
                yield key_media_path(tile_folder(p, count), t, q, number), entry
    for s, part in enumerate(table["segments"], segment):
        for j, level in enumerate(part["levels"]):
            for p, entry in enumerate(level["files"]):
                yield state_media_path(tile_folder(p, count), j, s), entry


def reindexed(files: Files) -> Files:
    """Make the index of a package without pages agree with the tables of its groups, and airgs.json with init.mp4."""
    try:
        root = parse_table(files[JSON_NAME])
        columns = root["index"][0]
        tables = [files[group_path(number)] for number in range(1, 1 + len(columns["frames"]))]
        columns["bytes"], columns["sha256"] = [len(data) for data in tables], "".join(map(digest, tables))
        root["init"] = {"bytes": len(files[INIT_NAME]), "sha256": digest(files[INIT_NAME])}
    except UNREADABLE:
        return files
    return files | {JSON_NAME: pack_table(JSON_NAME, root)}


def by_chance(chance: random.Random, *, tables: bool = True) -> Mutation:
    """One random change to one file; `tables`: airgs.json and manifest.mpd are among them, and more often."""

    def mutate(files: Files) -> Files:
        of_tables = [name for name in files if file_kind(name) is FileKind.MANIFESTS]
        names = list(files) if tables else [name for name in files if name not in of_tables]
        name = chance.choice(names) if chance.random() < 0.7 else chance.choice(of_tables if tables else names)
        if name in of_tables and name != MPD_NAME and chance.random() < 0.8:
            return files | {name: random_tables(chance, name, files[name])}
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


def random_tables(chance: random.Random, name: str, text: bytes) -> bytes:
    """One or two values somewhere in a table replaced, dropped, doubled or moved a little."""
    try:
        tables = parse_table(text)
    except UNREADABLE:
        return text
    for _ in range(chance.choice((1, 1, 1, 2))):
        _change_somewhere(chance, tables)
    return pack_table(name, tables)


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
