"""How soon does a training show as much as another one does? Trees of this project side by side, on the CPU.

Trees take turns to train the first frame alone, and then some frames, with efforts of their own `airgs-train`. `the
same, s`: of the CPU, in which a tree shows what the first one does with the last effort; empty where it never does.
"""

from __future__ import annotations

import json
import os
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
        words = [str(scene.resolve()), "--effort", effort, *shlex.split(options.train)]
        (first, shown), (whole, more) = (
            _trained(tree, [*words, "--frames", f":{n}"], lab) for n in (1, options.frames)
        )
        for phase, seconds, quality in (("first frame", first, shown[0]), ("others", whole - first, mean(more[1:]))):
            row: Row = {"scene": scene.name, "phase": phase, "tree": tree.resolve().name, "effort": effort}
            rows.append(row | {"CPU, s": seconds, "held-out, dB": quality})
    for one in [row for row in rows if row["effort"] == options.efforts[-1]]:
        alike = [row for row in rows if (row["scene"], row["phase"]) == (one["scene"], one["phase"])]
        wanted = next(row["held-out, dB"] for row in alike if row["effort"] == one["effort"])
        curve = sorted((row["held-out, dB"], row["CPU, s"]) for row in alike if row["tree"] == one["tree"])
        levels, taken = np.array(curve).T
        one["the same, s"] = float(np.interp(wanted, levels, taken, right=np.nan))
    return Page([Section("Seconds of the CPU, and what cameras see that were held out.", tables=[Table("pace", rows)])])


def _trained(tree: Path, words: list[str], lab: Lab) -> tuple[float, list[float]]:
    model, before = lab.folder / "model", os.times()
    call = [sys.executable, "-c", TRAIN, *words, "--device", "cpu", "-o", str(model)]
    subprocess.run(call, cwd=lab.folder, check=True, env=os.environ | {"PYTHONPATH": str(tree.resolve())})
    after, record = os.times(), json.loads((model / "training.json").read_text(encoding="utf-8"))
    shutil.rmtree(model)
    children = after.children_user + after.children_system - before.children_user - before.children_system
    return children, [frame["held_out_psnr"] for frame in record["frames"]]
