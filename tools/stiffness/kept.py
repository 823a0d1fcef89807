"""Sweeps that are finished stay finished: each is a file in the output folder, which a later run reads."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path

from airgs_codec._files import write_json
from tools.stiffness.outcome import Cell, Sweep


def sweep_once(folder: Path, name: str, variant: str, make: Callable[[], Sweep]) -> tuple[Sweep, float]:
    """The sweep of this name and the seconds that it took, from `folder` where a run of the same `variant` left it."""
    path = folder / f"{name}.json"
    found = read_sweep(path, variant)
    if found is not None:
        return found
    began = time.perf_counter()
    sweep = make()
    seconds = time.perf_counter() - began
    folder.mkdir(parents=True, exist_ok=True)
    write_json(path, {"variant": variant, "seconds": seconds, "sweep": asdict(sweep)})
    return sweep, seconds


def read_sweep(path: Path, variant: str) -> tuple[Sweep, float] | None:
    """A sweep from its file and the seconds that it took; None where there is none, or one of another variant."""
    try:
        stored = json.loads(path.read_text())
        if stored["variant"] != variant:
            return None
        table = stored["sweep"]
        cells = tuple(Cell(**cell | {"value": _number(cell["value"])}) for cell in table["cells"])
        return Sweep(**table | {"own": tuple(table["own"]), "cells": cells}), float(stored["seconds"])
    except (OSError, ValueError, KeyError, TypeError):
        return None


def _number(value: float | None) -> float:
    return math.nan if value is None else value
