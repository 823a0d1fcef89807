"""Changes to packages: the one engine behind the corpus of refusals, the tests and the fuzzer.

A package is held as its files, {relative path: bytes}; a mutation is a function from files to files, which leaves its
argument as it is. `apply` runs some in turn, `on_disk` writes the outcome, `honest` makes the lengths and digests in
the tables agree with the files, so that what lies behind the digests is reached.
"""

from __future__ import annotations

import gzip
import itertools
import json
import os
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

from tests import faces
from tests.faces import INIT_NAME, JSON_NAME, PAGE, digest, group_path, page_path

Files = dict[str, bytes]
Mutation = Callable[[Files], Files]
Place = tuple[str | int, ...]  # keyframes and indices from the root of a JSON document


class Link(bytes):
    """In place of the bytes of a file: a symbolic link, and where it leads."""


def read_files(folder: Path) -> Files:
    paths = [path for path in sorted(folder.rglob("*")) if path.is_file()]
    data = [Link(os.readlink(path).encode()) if path.is_symlink() else path.read_bytes() for path in paths]
    return {path.relative_to(folder).as_posix(): one for path, one in zip(paths, data, strict=True)}


def apply(files: Files, *mutations: Mutation) -> Files:
    for mutate in mutations:
        files = mutate(files)
    return files


def on_disk(folder: Path, *mutations: Mutation) -> Path:
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
    return edit_tables(lambda table: _parent(table, place).__setitem__(place[-1], value), name)


def drop_value(place: Place, name: str = JSON_NAME) -> Mutation:
    return edit_tables(lambda table: _parent(table, place).__delitem__(place[-1]), name)


def parse_table(data: bytes) -> Any:
    return json.loads(gzip.decompress(data) if data[:2] == b"\x1f\x8b" else data)


def pack_table(name: str, table: Any) -> bytes:
    text = json.dumps(table, separators=(",", ":")).encode()
    return gzip.compress(text, 9, mtime=0) if name.endswith(".gz") else text


def places(document: Any, above: Place = ()) -> Iterator[Place]:
    """Every place of a parsed JSON document, the root `()` first."""
    yield above
    found = dict(enumerate(document)) if isinstance(document, list) else document
    for name, inner in found.items() if isinstance(found, dict) else ():
        yield from places(inner, (*above, name))


def _parent(document: Any, place: Place) -> Any:
    for name in place[:-1]:
        document = document[name]
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
    return lambda files: files | {name: data}


def remove_file(name: str) -> Mutation:
    return lambda files: {other: data for other, data in files.items() if other != name}


def link_file(name: str, target: str) -> Mutation:
    return lambda files: files | {name: Link(target.encode())}


def honest(files: Files) -> Files:
    """Give every listed file its length and digest, up to the root; what cannot be read stays as it is."""
    out, segment = dict(files), 1
    for number in itertools.count(1):
        name = group_path(number)
        if name not in out:
            break
        with suppress(Exception):
            table = parse_table(out[name])
            before = json.dumps(table)
            for path, entry in _entries(table, number, segment):
                if path in out and entry["bytes"]:
                    entry |= {"bytes": len(out[path]), "sha256": digest(out[path])}
            segment += len(table["segments"])
            if json.dumps(table) != before:
                out[name] = pack_table(name, table)
    return reindexed(out)


def _entries(table: Any, number: int, segment: int) -> Iterator[tuple[str, Any]]:
    """Path and entry of every file of a group, whose first segment has the number `segment`."""
    if "sound" in table:
        yield faces.sound_path(number), table["sound"]
    for t, tier in enumerate(table["tiers"]):
        yield faces.keyframe_sidecar_path(t, number), tier["sidecar"]
        for q, entry in enumerate(tier["pictures"]):
            yield faces.keyframe_media_path(t, q, number), entry
    for s, part in enumerate(table["segments"], segment):
        for j, level in enumerate(part["levels"]):
            yield faces.delta_media_path(j, s), level["file"]


def reindexed(files: Files) -> Files:
    """Make the index agree with the tables of groups, page by page up to airgs.json, and that with init.mp4."""
    out = dict(files)
    with suppress(Exception):
        root = parse_table(out[JSON_NAME])
        index = root["index"]
        groups = sum(len(columns["frames"]) * PAGE**level for level, columns in enumerate(index))
        for level in range(1, len(index)):
            for number in range(1, groups // PAGE**level + 1):
                name = page_path(level, number)
                if name not in out:
                    break
                with suppress(Exception):
                    page = parse_table(out[name])
                    _stamp(out, page, level - 1, PAGE * number)
                    out[name] = pack_table(name, page)
        for level, columns in enumerate(index):
            _stamp(out, columns, level, groups // PAGE**level)
        root["init"] = {"bytes": len(out[INIT_NAME]), "sha256": digest(out[INIT_NAME])}
        out[JSON_NAME] = pack_table(JSON_NAME, root)
    return out


def _stamp(files: Files, columns: Any, level: int, last: int) -> None:
    """Give the columns of a level the lengths and digests of its files up to the number `last`."""
    numbers = range(last - len(columns["frames"]) + 1, last + 1)
    found = [files[page_path(level, n) if level else group_path(n)] for n in numbers]
    columns["bytes"], columns["sha256"] = [len(data) for data in found], "".join(map(digest, found))
