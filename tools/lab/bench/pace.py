"""How long do encodes and trainings take? Trees of this project side by side, in seconds of the CPU, imports counted.

Trees take turns. An encode is that of each preset which a tree has, on one core. A training is that of the first frame
alone, and then of some frames, with efforts of the tree's own `airgs-train`. `the same, s`: seconds in which a tree
shows what the first one does with the last effort; empty where it never does.
"""

from __future__ import annotations

import json
import os
import shlex
import shutil
import subprocess
import sys
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from statistics import mean, median

import numpy as np

from airgs_codec.errors import ConfigError
from tools.lab import Lab, Page, Row, Section, Table, required, setting

CALL = "import os, sys; os.sched_setaffinity(0, {0}); from airgs_codec.cli.%s import main; sys.exit(main())"


@dataclass(frozen=True, slots=True)
class Options:
    scenes: tuple[Path, ...] = required("what airgs-encode reads, or with --train airgs-train")
    trees: tuple[Path, ...] = setting((Path(),), "folders with airgs_codec in them")
    presets: tuple[str, ...] = setting(("default", "fast"), "of airgs-encode, those of a tree that it has")
    repeats: int = setting(3, "of each encode, whose median is given")
    train: bool = setting(False, "train, instead of encoding")
    efforts: tuple[str, ...] = setting(("quick", "normal"), "as airgs-train has them, the least first")
    frames: int = setting(4, "that are trained of each scene")
    options: str = setting("", "further options of airgs-train, in one word")


def run(options: Options, lab: Lab) -> Page:
    return _trainings(options, lab) if options.train else _encodes(options, lab)


def _encodes(options: Options, lab: Lab) -> Page:
    rows: list[Row] = []
    for scene, preset in product(options.scenes, options.presets):
        runs = product(range(options.repeats), options.trees)
        words = [str(scene.resolve()), "--preset", preset, "--fps", "30", "-o", str(lab.folder / "out.airgs")]
        taken = [(tree, _seconds(tree, "encode", words, lab)) for _, tree in runs]
        for tree in options.trees:
            row: Row = {"scene": scene.stem, "preset": preset, "tree": tree.name or "here"}
            found = [seconds for one, seconds in taken if one == tree and seconds is not None]
            first = next((one["CPU, s"] for one in rows if one["scene"] == scene.stem), 0.0)
            if found:
                rows.append(row | {"CPU, s": median(found), "share": median(found) / first if first else 1.0})
    columns = {name: (name, "") for name in ("scene", "preset", "tree")}
    columns |= {"CPU, s": ("CPU, s", ".1f"), "share": ("of the first tree's default", ".2f")}
    how = f"Medians of {options.repeats} encodes in seconds of one core, imports and measuring counted."
    return Page([Section("", tables=[Table("pace", rows, columns)])], how)


def _trainings(options: Options, lab: Lab) -> Page:
    rows: list[Row] = []
    runs = ((scene, effort, tree) for scene in options.scenes for effort in options.efforts for tree in options.trees)
    for scene, effort, tree in runs:
        words = [str(scene.resolve()), "--effort", effort, *shlex.split(options.options)]
        (first, shown), (whole, more) = (
            _trained(tree, [*words, "--frames", f":{n}"], lab) for n in (1, options.frames)
        )
        for phase, seconds, quality in (("first frame", first, shown[0]), ("others", whole - first, mean(more[1:]))):
            row: Row = {"scene": scene.name, "phase": phase, "tree": tree.name or "here", "effort": effort}
            rows.append(row | {"CPU, s": seconds, "held-out, dB": quality})
    for one in [row for row in rows if row["effort"] == options.efforts[-1]]:
        alike = [row for row in rows if (row["scene"], row["phase"]) == (one["scene"], one["phase"])]
        wanted = next(row["held-out, dB"] for row in alike if row["effort"] == one["effort"])
        curve = sorted((row["held-out, dB"], row["CPU, s"]) for row in alike if row["tree"] == one["tree"])
        levels, taken = np.array(curve).T
        one["the same, s"] = float(np.interp(wanted, levels, taken, right=np.nan))
    return Page([Section("", tables=[Table("pace", rows)])], "Seconds of the CPU, and PSNR of held-out cameras.")


def _trained(tree: Path, words: list[str], lab: Lab) -> tuple[float, list[float]]:
    model = lab.folder / "model"
    seconds = _seconds(tree, "train", [*words, "--device", "cpu", "-o", str(model)], lab)
    if seconds is None:
        raise ConfigError(f"{tree}: airgs-train failed")
    record = json.loads((model / "training.json").read_text(encoding="utf-8"))
    shutil.rmtree(model)
    return seconds, [frame["held_out_psnr"] for frame in record["frames"]]


def _seconds(tree: Path, program: str, words: list[str], lab: Lab) -> float | None:
    """Return the seconds of the CPU that a program of a tree takes; None where it fails."""
    before = os.times()
    call = [sys.executable, "-c", CALL % program, *words]
    places = {"PYTHONPATH": str(tree.resolve()), "XDG_CACHE_HOME": str(lab.folder / "stored")}  # of older trees
    done = subprocess.run(call, cwd=lab.folder, check=False, env=os.environ | places)
    after = os.times()
    for made in ("stored", "out.airgs"):
        shutil.rmtree(lab.folder / made, ignore_errors=True)
    taken = after.children_user + after.children_system - before.children_user - before.children_system
    return None if done.returncode else taken
