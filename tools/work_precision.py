"""Error against run time, of everything that trades one for the other.

    python -m tools.work_precision -o OUT [--quick] [--only SECTION,...] [--scene fox=DIR] [--spinach FILE.splatv]

Writes OUT/work_precision.csv (a row a measurement), .json (the same with machine, versions and command), a picture for
each section, and work_precision.md with a conclusion for every panel. What is finished is kept in OUT/rows.jsonl: a run
that was killed goes on where it ended when it is started again. After a change of the code take another OUT.

`--scene fox=DIR`: the fox in full in place of the embedded cut, DIR=VIEWS where its cameras lie elsewhere. `--spinach`:
a clip with spinach_views.json beside it.
"""

from __future__ import annotations

import argparse
import csv
import os
import platform
import shlex
import sys
import time
from collections.abc import Sequence
from pathlib import Path

os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
if __name__ == "__main__":  # before numba starts its threads: a second one would cost CPU time by waiting
    os.environ.setdefault("NUMBA_NUM_THREADS", "1")

import numba
import numpy as np
import torch

from airgs_codec._files import write_bytes, write_json
from airgs_codec.cli.common import run_command
from airgs_codec.errors import ConfigError
from airgs_codec.media.h264 import library_versions
from tools.precision.bench import FOX, Bench, Scene, open_scene, open_spinach
from tools.precision.page import Made, conclude, page
from tools.precision.panels import NAMES, SECTIONS
from tools.precision.pictures import picture_path, plot
from tools.precision.rows import Kept, Row, plain


def parse(argv: Sequence[str] | None) -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="OUT")
    parser.add_argument("--quick", action="store_true", help="fewer points and runs")
    parser.add_argument("--only", type=read_sections, default=NAMES, metavar="SECTION,...", help=", ".join(NAMES))
    parser.add_argument("--scene", default=f"fox={FOX}", metavar="NAME=DIR[=VIEWS]")
    parser.add_argument("--spinach", type=Path, metavar="FILE.splatv")
    parser.add_argument("--finished", action="store_true", help="measure nothing, report what is finished")
    parser.add_argument("--note", default="", metavar="TEXT", help="a sentence on the machine, for the page")
    return parser.parse_args(argv)


def read_sections(text: str) -> tuple[str, ...]:
    """Names of sections with commas. Raises ArgumentTypeError."""
    names = tuple(text.split(","))
    unknown = [name for name in names if name not in NAMES]
    if unknown:
        raise argparse.ArgumentTypeError(f"expected {', '.join(NAMES)}, got {', '.join(unknown)}")
    return names


def open_bench(args: argparse.Namespace) -> Bench:
    """The scenes and what was kept. Raises SceneError, ConfigError."""
    scenes = [open_scene(args.scene)]
    if args.spinach is not None:
        scenes.append(open_spinach(args.spinach))
    if not all(scene.sequence.cameras for scene in scenes):
        raise ConfigError("--scene: expected cameras beside the frames, or NAME=DIR=VIEWS")
    args.output.mkdir(parents=True, exist_ok=True)
    kept = Kept(args.output / "rows.jsonl", lambda line: print(line, flush=True), more=not args.finished)
    return Bench(tuple(scenes), args.output, kept, args.quick)


def write(rows: list[Row], folder: Path, record: dict[str, object], made: Made) -> None:
    """All tables, pictures and the page."""
    with (folder / "work_precision.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(plain(rows[0])), lineterminator="\n")
        writer.writeheader()
        writer.writerows({k: f"{v:.6g}" if isinstance(v, float) else v for k, v in plain(row).items()} for row in rows)
    write_json(folder / "work_precision.json", record | {"rows": [plain(row) for row in rows]})
    for section in SECTIONS:
        if any(row.section == section.name for row in rows):
            plot(section, rows, picture_path(folder, section))
    write_bytes(folder / "work_precision.md", page(rows, made).encode())


def about(scene: Scene) -> str:
    """A scene in words."""
    counts = [header.count for header in scene.sequence.headers]
    rows = f"{min(counts):,} to {max(counts):,}" if min(counts) < max(counts) else f"{counts[0]:,}"
    return f"{scene.name}, {len(counts)} frames of {rows} Gaussians"


def run(args: argparse.Namespace) -> int:
    """Measure what is missing, then write everything. Raises AirgsError."""
    bench, began = open_bench(args), time.perf_counter()
    rows = [row for section in SECTIONS if section.name in args.only for row in section.measure(bench)]
    if not rows:
        raise ConfigError(f"{args.output}: expected finished measurements, got none")
    seconds = time.perf_counter() - began
    versions = library_versions() | {"numpy": np.__version__, "numba": numba.__version__, "torch": torch.__version__}
    machine = {"processor": platform.machine(), "cores": os.cpu_count(), "python": platform.python_version()}
    command = shlex.join(["python", "-m", "tools.work_precision", *args.words])
    record = {"command": command, "seconds": seconds, "note": args.note, "machine": machine, "versions": versions}
    words = f"Measured on {os.cpu_count()} {platform.machine()} cores with Python {platform.python_version()}."
    made = Made(command_of(args), f"{words} {args.note}".strip(), [about(scene) for scene in bench.scenes])
    write(rows, args.output, record, made)
    for section in SECTIONS:
        for panel in section.panels:
            if sentence := conclude(section, panel, rows):
                print(f"{panel.question} {sentence}")
    print(f"{seconds:.0f} s, {args.output}")
    return 0


def command_of(args: argparse.Namespace) -> str:
    """The command with plain names for folders."""
    words = ["python -m tools.work_precision -o out/"]
    words += ["--quick"] * args.quick
    words += [f"--only {','.join(args.only)}"] if args.only != NAMES else []
    words += ["--scene fox=fox/"] if args.scene != f"fox={FOX}" else []
    words += [f"--spinach {args.spinach.name}"] if args.spinach else []
    return " ".join(words)


def main(argv: Sequence[str] | None = None) -> int:
    """Run; gives the exit status."""
    args = parse(argv)
    args.words = list(sys.argv[1:] if argv is None else argv)
    torch.set_num_threads(1)
    return run_command("work_precision", lambda: run(args))


if __name__ == "__main__":
    sys.exit(main())
