"""A keyframe from the frame before against one from scratch (SIFT tracks of that frame): seconds to equal PSNR.

    python -m tools.bench_keyframe SCENE MODEL [--frame T] [--max-size PX]

MODEL: the model folder that `airgs-train SCENE` made; T: one of its keyframes (default: the first after frame 0). Both
run with the settings of the model in several lengths, each a whole fit; PSNR is the mean over held-out views.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path

os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

import numpy as np
import torch

from airgs_codec.media.metrics import mse, psnr
from airgs_codec.render import render
from airgs_codec.scene.gaussians import Gaussians
from airgs_codec.scene.ply import read_ply
from airgs_codec.train.data.multiview import Pictures, View, with_held_out
from airgs_codec.train.data.readers import open_scene
from airgs_codec.train.fit.temporal import Temporal
from airgs_codec.train.record import RECORD_NAME
from airgs_codec.train.settings import TrainSettings
from airgs_codec.train.stages import make_trainer

WARM = (25, 50, 100, 200, 400, 800, 1500)  # iterations
SCRATCH = (200, 300, 400, 500, 600, 800, 1200, 2500)


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", type=Path)
    parser.add_argument("model", type=Path)
    parser.add_argument("--frame", type=int)
    args = parser.parse_args()
    torch.set_num_threads(1)
    record = json.loads((args.model / RECORD_NAME).read_text())
    known = {f.name for f in fields(TrainSettings)}
    stored = {n: v for n, v in record["settings"].items() if n in known}
    stored |= {"temporal": Temporal(**stored["temporal"]), "drop": float(stored["drop"])}
    settings = TrainSettings(**stored)
    keys = [f["frame"] for f in record["frames"] if f["kind"] == "key"]
    frame = args.frame if args.frame is not None else keys[0]
    scene = with_held_out(open_scene(args.scene), None)
    pictures = Pictures(scene, settings.max_size, settings.foreground)
    views, held_out = pictures.train(frame), pictures.held_out(frame)
    trainer = make_trainer(settings, views, scene.points, "cpu")
    before, earlier = (read_ply(args.model / f"{frame - i:06d}.ply") for i in (1, 2))
    steps = trainer.steps(before, pictures.train(frame - 1))

    def warm(iterations: int) -> Gaussians:
        short = replace(trainer, settings=replace(settings, key_iterations=iterations))
        return short.keyframe(frame, before, before.means - earlier.means, steps, views)

    def scratch(iterations: int) -> Gaussians:
        short = replace(trainer, settings=replace(settings, first_iterations=iterations))
        return short.first(frame, None, views)

    warm(1)  # compiles
    print(f"{'':>20} {'iterations':>10} {'seconds':>8} {'PSNR':>6} {'Gaussians':>10}")
    curves = {
        "from the frame before": follow("from the frame before", warm, WARM, held_out),
        "from scratch": follow("from scratch", scratch, SCRATCH, held_out),
    }
    fast, slow = curves.values()
    print(f"U = {len(before):,}; at most {100 * (max(n for *_, n in fast) / len(before) - 1):.1f} % added")
    for seconds, quality, _ in slow:
        first = next((s for s, q, _ in fast if q >= quality), None)
        if first is not None:
            print(f"{quality:.2f} dB: {first:.1f} s against {seconds:.1f} s, {seconds / first:.1f} times faster")


def follow(
    name: str, fit: Callable[[int], Gaussians], counts: tuple[int, ...], held_out: list[View]
) -> list[tuple[float, float, int]]:
    """(seconds, PSNR, Gaussians) of whole fits of several lengths."""
    curve = []
    for count in counts:
        begun = time.perf_counter()
        g = fit(count)
        seconds = time.perf_counter() - begun
        quality = float(np.mean([psnr(mse(render(g, v.camera).rgb, v.target.rgb)) for v in held_out]))
        curve.append((seconds, quality, len(g)))
        print(f"{name:>20} {count:10} {seconds:8.1f} {quality:6.2f} {len(g):10,}", flush=True)
    return curve


if __name__ == "__main__":
    main()
