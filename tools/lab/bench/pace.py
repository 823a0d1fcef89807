"""How soon does a training show as much as another one does? Trees of this project side by side, on the CPU.

Every tree trains the first frame alone, and then some frames, with the efforts of its own `airgs-train`, and trees take
turns. Seconds are those of the CPU; of others than first frames together. `the same, s`: in which a tree shows what the
first tree does with the last effort, between what it takes with two of them; empty where it never shows as much.
"""

from __future__ import annotations

import json
import os
import resource
import shlex
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from statistics import mean

import numpy as np

from tools.lab import Lab, Page, Row, Section, Table, required, setting

TRAIN = "import sys; from airgs_codec.cli.train import main; sys.exit(main())"


@dataclass(frozen=True, slots=True)
class Options:
    scenes: tuple[Path, ...] = required("what airgs-train reads")
    trees: tuple[Path, ...] = setting((Path(),), "folders with airgs_codec in them")
    efforts: tuple[str, ...] = setting(("quick", "normal"), "as airgs-train has them, the least first")
    frames: int = setting(4, "of each scene")
    train: str = setting("", "further options of airgs-train, in one word")


def run(options: Options, lab: Lab) -> Page:
    rows: list[Row] = []
    runs = ((scene, effort, tree) for scene in options.scenes for effort in options.efforts for tree in options.trees)
    for scene, effort, tree in runs:
        words = [str(scene.resolve()), "--device", "cpu", "--effort", effort, *shlex.split(options.train)]
        (first, shown), (whole, more) = (
            _trained(tree, [*words, "--frames", f":{n}"], lab) for n in (1, options.frames)
        )
        for phase, seconds, quality in (("first frame", first, shown[0]), ("others", whole - first, mean(more[1:]))):
            row: Row = {"scene": scene.name, "phase": phase, "tree": tree.resolve().name, "effort": effort}
            rows.append(row | {"CPU, s": seconds, "held-out, dB": quality})
        lab.tell(f"{rows[-2:]}")
    for one in [row for row in rows if row["effort"] == options.efforts[-1]]:
        alike = [row for row in rows if (row["scene"], row["phase"]) == (one["scene"], one["phase"])]
        wanted = next(row["held-out, dB"] for row in alike if row["effort"] == one["effort"])
        curve = sorted((row["held-out, dB"], row["CPU, s"]) for row in alike if row["tree"] == one["tree"])
        levels, seconds_of = np.array(curve).T
        one["the same, s"] = float(np.interp(wanted, levels, seconds_of, right=np.nan))
    words = [f"{row['tree']}, {row['scene']}, {row['phase']}: {row['CPU, s']:.1f} s" for row in rows]
    return Page([Section("; ".join(words) + ".", tables=[Table("pace", rows)])])


def _trained(tree: Path, words: list[str], lab: Lab) -> tuple[float, list[float]]:
    model = lab.folder / "model"
    with_tree, before = os.environ | {"PYTHONPATH": str(tree.resolve())}, _spent()
    subprocess.run([sys.executable, "-c", TRAIN, *words, "-o", str(model)], cwd=lab.folder, check=True, env=with_tree)
    seconds, record = _spent() - before, json.loads((model / "training.json").read_text(encoding="utf-8"))
    shutil.rmtree(model)
    return seconds, [frame["held_out_psnr"] for frame in record["frames"]]


def _spent() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime
