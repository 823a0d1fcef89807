"""The cases of manifests/invalid, whose README.md says how they are written: packages that are to be refused."""

from __future__ import annotations

import base64
import json
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from tests.faces import FormatError, Memory, validate, validate_files
from tests.support.mutations import Files, Link, read_files, write_files
from tests.support.paths import INVALID, VALID


@dataclass(frozen=True, slots=True)
class Case:
    """A package, as the changes to a valid one, and why it is refused."""

    base: str  # a folder of manifests/valid
    name: str
    reason: str
    where: str
    files: Mapping[str, Any]  # path -> what becomes of the file

    def package(self) -> Files:
        files = dict(base_files(self.base))
        for path, change in self.files.items():
            if change is None:
                del files[path]
            else:
                files[path] = changed(files.get(path, b""), change)
        return files


@cache
def base_files(name: str) -> Files:
    return read_files(VALID / name)


def changed(before: bytes, change: Mapping[str, Any]) -> bytes:
    """A file after one of the changes of a case. Raises ValueError where a text to replace is not there once."""
    match change:
        case {"link": link}:
            return Link(link.encode())
        case {"data": data}:
            return base64.b64decode(data, validate=True)
    text = before.decode()
    for old, new in change.get("replace", []):
        if text.count(old) != 1:
            raise ValueError(f"expected {old!r} once, got it {text.count(old)} times")
        text = text.replace(old, new)
    return text.ljust(change.get("spaces_to", 0)).encode()


@cache
def cases() -> dict[str, Case]:
    found = {}
    for path in sorted(INVALID.glob("*.json")):
        for case in json.loads(path.read_text())["cases"]:
            found[case["name"]] = Case(path.stem, **case)
    return found


def findings(files: Files) -> list[FormatError]:
    """What is wrong with a package; links are there on disk alone."""
    if any(isinstance(data, Link) for data in files.values()):
        with tempfile.TemporaryDirectory() as folder:
            return validate(write_files(Path(folder), files))
    return validate_files(Memory("package", files))
