"""Functions that workers can find: quickly, so little is imported here."""

from __future__ import annotations

import os
import pickle
from collections.abc import Container
from pathlib import Path

from airgs_codec.errors import FormatError


def square(number: int, folder: str, dies: Container[int] = ()) -> int:
    """The square of a number; leaves a line in a file of the folder for every call.

    Ends its process the first time that it is called for a number that `dies`, as a machine that is taken away.
    """
    flag = Path(folder) / f"died-{number}"
    if number in dies and not flag.exists():
        flag.touch()
        os._exit(9)
    with open(f"{folder}/calls-{number}", "a", encoding="utf-8") as file:
        file.write("x")
    return number * number


def refuse(number: int) -> None:
    raise FormatError("bad_value", f"job {number}", "expected another number")


def die() -> None:
    os._exit(9)


def calls(folder: Path) -> dict[str, int]:
    return {path.name.removeprefix("calls-"): len(path.read_text()) for path in Path(folder).glob("calls-*")}


def read_packed(packed: bytes) -> tuple[object, str, int]:
    """The positions of the last frame of a sequence, the name of its file, and which copy it is from."""
    sequence = pickle.loads(packed)
    return sequence.read(len(sequence) - 1).means, sequence.name_of(sequence.paths[-1]), id(sequence.copied)
