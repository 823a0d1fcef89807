"""A keyframe from the frame before against one from scratch (SIFT tracks of that frame): seconds to equal PSNR.

    python -m tools.bench_keyframe SCENE MODEL [--frame T] [--max-size PX]

MODEL: the model folder that `airgs-train SCENE` made; T: the frame, from 1 on (default: the model's first keyframe
after frame 0). Both fits run with the settings of the model in several lengths, each a whole fit, on pictures shrunk to
a longest side of PX pixels (default: as the model was trained). PSNR is the mean over held-out views of each view's.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

import torch

from airgs_codec.errors import AirgsError, ConfigError
from airgs_codec.scene.gaussians import Gaussians
from airgs_codec.train.data.multiview import with_held_out
from airgs_codec.train.data.pictures import View, pictures_for
from airgs_codec.train.data.plates import find_plates
from airgs_codec.train.data.readers import open_scene
from airgs_codec.train.fit.parameters import Parameters
from airgs_codec.train.frames import Capture
from airgs_codec.train.quality import mean_psnr
from airgs_codec.train.record import Model, read_model
from airgs_codec.train.run import frame_before
from airgs_codec.train.settings import settings_from_table
from airgs_codec.train.stages import FrameBefore, FrameViews, Trainer

WARM = (25, 50, 100, 200, 400, 800, 1500)  # iterations
SCRATCH = (200, 300, 400, 500, 600, 800, 1200, 2500)


@dataclass(frozen=True, slots=True, eq=False)
class Case:
    """A frame that both fits are made of."""

    trainer: Trainer
    target: FrameViews
    before: FrameBefore
    steps: Parameters  # codec steps of the frame before
    held_out: Sequence[View]

    def warm(self, iterations: int) -> Gaussians:
        """A keyframe from the frame before."""
        short = replace(self.trainer, settings=replace(self.trainer.settings, key_iterations=iterations))
        return short.fit_keyframe(self.target, self.before, self.steps)

    def scratch(self, iterations: int) -> Gaussians:
        """A keyframe from points found in its pictures."""
        short = replace(self.trainer, settings=replace(self.trainer.settings, first_iterations=iterations))
        return short.fit_first(self.target, None)


def main(argv: Sequence[str] | None = None) -> int:
    """Run and print; returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", type=Path)
    parser.add_argument("model", type=Path)
    parser.add_argument("--frame", type=int)
    parser.add_argument("--max-size", type=int)
    args = parser.parse_args(argv)
    torch.set_num_threads(1)
    try:
        compare(open_case(args.scene, args.model, args.frame, args.max_size))
    except AirgsError as error:
        print(f"bench_keyframe: {error}", file=sys.stderr)
        return 2
    return 0


def open_case(scene_folder: Path, model_folder: Path, frame: int | None, max_size: int | None) -> Case:
    """The frame of a model; None stands for its first keyframe after frame 0, and for the model's size of pictures.

    Raises ConfigError for a frame that the model does not have or that nothing comes before.
    """
    model = read_model(model_folder)
    frame = chosen_frame(model, frame)
    settings = settings_from_table(model.record.settings)
    if max_size is not None:
        settings = replace(settings, max_size=max_size)
    scene = with_held_out(open_scene(scene_folder), None)
    capture = Capture.of(scene, pictures_for(scene, settings), settings, "cpu")
    plates = find_plates(scene, capture.pictures) if settings.knows_rest else {}
    capture = replace(capture.with_exposure(model.record.exposure), plates=plates)
    before, pictures = frame_before(model, frame), capture.pictures
    steps = capture.trainer.steps(before.gaussians, pictures.train(frame - 1))
    return Case(capture.trainer, capture.target(frame, frame - 1), before, steps, pictures.held_out(frame))


def chosen_frame(model: Model, frame: int | None) -> int:
    """The frame, or the first keyframe after frame 0. Raises ConfigError when the model does not have it."""
    count, keys = len(model.record.frames), model.record.keyframes()[1:]
    if frame is None:
        if not keys:
            raise ConfigError(f"{model.folder}: expected a keyframe after frame 0, got none; name a frame with --frame")
        return keys[0]
    if not 1 <= frame < count:
        raise ConfigError(f"--frame: expected a frame from 1 to {count - 1}, got {frame}")
    return frame


def compare(case: Case) -> None:
    """Print both curves, and how much sooner the warm start reaches what the other does."""
    case.warm(1)  # compiles
    print(f"{'':>20} {'iterations':>10} {'seconds':>8} {'PSNR':>6} {'Gaussians':>10}")
    fast = follow("from the frame before", case.warm, WARM, case.held_out)
    slow = follow("from scratch", case.scratch, SCRATCH, case.held_out)
    rows = len(case.before.gaussians)
    print(f"U = {rows:,}; at most {100 * (max(n for *_, n in fast) / rows - 1):.1f} % added")
    for seconds, quality, _ in slow:
        first = next((s for s, q, _ in fast if q >= quality), None)
        if first is not None:
            print(f"{quality:.2f} dB: {first:.1f} s against {seconds:.1f} s, {seconds / first:.1f} times faster")


def follow(
    name: str, fit: Callable[[int], Gaussians], counts: Sequence[int], held_out: Sequence[View]
) -> list[tuple[float, float, int]]:
    """(seconds, PSNR in dB, Gaussians) of whole fits of several lengths."""
    curve = []
    for count in counts:
        begun = time.perf_counter()
        g = fit(count)
        seconds = time.perf_counter() - begun
        quality = mean_psnr(g, held_out)
        curve.append((seconds, quality, len(g)))
        print(f"{name:>20} {count:10} {seconds:8.1f} {quality:6.2f} {len(g):10,}", flush=True)
    return curve


if __name__ == "__main__":
    sys.exit(main())
