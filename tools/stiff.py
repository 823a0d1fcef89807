"""Numerical stability on stiff and extreme cases: where every part converges, is bounded, or refuses.

    python -m tools.stiff -o OUT [--quick] [--only PART,...]

Parts are trainer, gradients, codec and selector. Writes OUT/stiff.md and its maps (docs/stiff.md and the pictures
beside it are made so), and keeps every finished sweep as OUT/NAME.json: a run that was interrupted goes on where it
was; after a change of the code take another OUT. --quick takes a few values of everything. Exit
status 1 where the code as it is diverges or is not finite.
"""

from __future__ import annotations

import argparse
import os
import platform
import sys
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path

os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

import torch

from airgs_codec._files import write_bytes
from airgs_codec.errors import AirgsError, ConfigError
from airgs_codec.render import cpu
from tools.stiffness import selector, steps
from tools.stiffness.fits import sweep_fits
from tools.stiffness.gradients import sweep_gradients
from tools.stiffness.kept import sweep_once
from tools.stiffness.maps import draw_maps
from tools.stiffness.outcome import FAULTS, Sweep, count_ends
from tools.stiffness.page import write_page
from tools.stiffness.scenes import AXES

TARGETS = ("motion", "changes")  # axes that change the target of a fit, not where its gradients begin
Make = Callable[[bool], Sweep]
COLUMNS = {"trainer": 4, "gradients": 3, "codec": 3, "selector": 2}  # panels in a row of a map


def parts() -> dict[str, dict[str, Make]]:
    """The sweeps of every part by the names of their files."""
    return {
        "trainer": {f"train-{a.name}": partial(sweep_fits, a) for a in AXES},
        "gradients": {f"gradients-{a.name}": partial(sweep_gradients, a) for a in AXES if a.name not in TARGETS},
        "codec": {
            "codec-closed-form": steps.sweep_closed_form,
            "codec-steps": steps.sweep_steps,
            "codec-klt": steps.sweep_klt,
            "codec-classes": steps.sweep_classes,
            "codec-scenes": steps.sweep_made_scenes,
        },
        "selector": {
            "selector-programmes": selector.sweep_programmes,
            "selector-margin": selector.sweep_margin,
            "selector-sessions": selector.sweep_sessions,
        },
    }


def run(output: Path, chosen: Sequence[str], quick: bool) -> dict[str, list[Sweep]]:
    """All sweeps of the chosen parts, those that are there taken from OUT, and then the page."""
    done: dict[str, list[Sweep]] = {}
    total = 0.0
    variant = "quick" if quick else "whole"
    with cpu.one_thread():
        for part, sweeps in parts().items():
            for name, make in sweeps.items() if part in chosen else ():
                sweep, seconds = sweep_once(output, name, variant, partial(make, quick))
                done.setdefault(part, []).append(sweep)
                total += seconds
                print(f"{name:<24}{seconds:7.1f} s  {count_ends(sweep.shipped)}", flush=True)
    write_bytes(output / "stiff.md", write_page(done, _draw(done, output), _made(total, quick)).encode())
    return done


def _draw(done: Mapping[str, Sequence[Sweep]], output: Path) -> dict[str, str]:
    """Draw the maps: one for each sweep of the trainer, which have many panels, else one for each part."""
    shown: dict[str, tuple[list[Sweep], int]] = {}
    for part, sweeps in done.items():
        found = [sweep for sweep in sweeps if sweep.x_label]
        if part == "trainer":
            shown |= {sweep.name: ([sweep], COLUMNS[part]) for sweep in found}
        else:
            shown[part] = found, COLUMNS[part]
    pictures = {name: f"stiff-{name}.png" for name in shown}
    for name, (found, columns) in shown.items():
        draw_maps(found, output / pictures[name], columns)
    return pictures


def _made(seconds: float, quick: bool) -> str:
    option = " with --quick" if quick else ""
    machine = f"{platform.machine()}, one thread"
    return f"Made{option} in {seconds:.0f} s of computing ({machine}, on a machine that others used, too)."


def main(argv: Sequence[str] | None = None) -> int:
    """Measure, write; returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--only", help="parts to do, with commas (default: all)")
    args = parser.parse_args(argv)
    torch.set_num_threads(1)
    try:
        chosen = list(parts()) if args.only is None else args.only.split(",")
        if unknown := sorted(set(chosen) - set(parts())):
            raise ConfigError(f"expected parts {', '.join(parts())}, got {', '.join(unknown)}")
        args.output.mkdir(parents=True, exist_ok=True)
        done = run(args.output, chosen, args.quick)
    except AirgsError as error:
        print(f"stiff: {error}", file=sys.stderr)
        return 2
    wrong = [cell for sweeps in done.values() for sweep in sweeps for cell in sweep.shipped if cell.end in FAULTS]
    for cell in wrong:
        print(f"{cell.panel} {cell.y} at {cell.x:g} {cell.end}: {cell.note}")
    return int(bool(wrong))


if __name__ == "__main__":
    sys.exit(main())
