"""What the suite does in small, done for hours; exit status 1 where something was wrong.

    python -m tests.long [NAME ...] [--times N] [--seed 0]

Prints a line for each thing that was done, with what was wrong. By default it does all of these:
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from unittest.mock import patch

from tests.long.faults import fail, fill_disks, interrupt, jump, kill_trainings
from tests.long.fuzz import mutate_files
from tests.long.watch import watch_browsers
from tools.lab import main as lab


def fail_farm(times: int, seed: int, folder: Path) -> Iterator[tuple[str, str]]:
    counts = ["--groups", str(times), "--kills", str(times), "--seed", str(seed)]
    yield "a farm that fails", "other bytes" if lab(["soak-farm", *counts, "-o", str(folder / "farm")]) else ""


@dataclass(frozen=True)
class Row:
    name: str
    what: str
    do: Callable[[int, int, Path], Iterator[tuple[str, str]]]  # takes how often, a seed and an empty folder
    times: int
    unit: str = "times"


ROWS = (
    Row("files", "mutated files are read or refused", mutate_files, 100_000, "cases"),
    Row("disks", "encodes on disks that are full", fill_disks, 20),
    Row("encodes", "encodes that are interrupted or killed", interrupt, 40),
    Row("trainings", "trainings that are killed", kill_trainings, 20, "kills"),
    Row("clocks", "publishers and players whose clocks jump", jump, 20),
    Row("stores", "stores and packages that do not answer", fail, 20),
    Row("farm", "an encode on a cluster whose parts fail", fail_farm, 50, "failures"),
    Row("browsers", "players that play on and on", watch_browsers, 30, "minutes"),
)


def main() -> int:
    table = "\n".join(f"    {row.name:<10} {row.what}, {row.times:,} {row.unit}" for row in ROWS)
    form = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser("python -m tests.long", description=f"{__doc__}\n{table}", formatter_class=form)
    names = [row.name for row in ROWS]
    parser.add_argument("names", nargs="*", metavar="NAME", help="of the table, by default all")
    parser.add_argument("--times", type=int, help="in place of that of the table")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    if unknown := set(options.names) - set(names):
        parser.error(f"expected some of {', '.join(names)}, got {', '.join(sorted(unknown))}")
    findings = 0
    for row in (row for row in ROWS if row.name in (options.names or names)):
        with tempfile.TemporaryDirectory() as name, patch.dict(os.environ, {"XDG_CACHE_HOME": f"{name}/cache"}):
            for what, wrong in row.do(options.times or row.times, options.seed, Path(name)):
                findings += bool(wrong)
                print(f"{row.name}: {what}{': ' * bool(wrong)}{wrong}", flush=True)
    print(f"{findings} findings")
    return bool(findings)


if __name__ == "__main__":
    sys.exit(main())
