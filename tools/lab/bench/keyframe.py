"""A keyframe from the frame before against one from scratch (SIFT tracks of that frame): CPU time to equal PSNR.

MODEL is the folder that `airgs-train SCENE` made. Both fits run with the settings of the model in several lengths, each
a whole fit. PSNR is the mean over held-out views in step of each view's.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import torch

from airgs_codec.errors import ConfigError
from airgs_codec.scene.gaussians import Gaussians
from airgs_codec.trainer.capture import Capture, First
from airgs_codec.trainer.data.multiview import with_held_out
from airgs_codec.trainer.data.pictures import View
from airgs_codec.trainer.data.readers import open_scene
from airgs_codec.trainer.data.sync import in_step
from airgs_codec.trainer.fit.first import fit_first
from airgs_codec.trainer.fit.losses import mean_psnr
from airgs_codec.trainer.fit.parameters import Parameters
from airgs_codec.trainer.fit.trainer import FrameViews, InMotion, Trainer
from airgs_codec.trainer.frames import frame_before
from airgs_codec.trainer.pipeline import rested
from airgs_codec.trainer.record import known_offsets, read_model
from airgs_codec.trainer.settings import settings_from_table
from tools.lab import Lab, Page, Row, Section, Table, required, seconds_of

WARM = (25, 50, 100, 200, 400, 800, 1500)  # iterations
SCRATCH = (200, 300, 400, 500, 600, 800, 1200, 2500)


@dataclass(frozen=True, slots=True)
class Options:
    scene: Path = required("what was trained on, as airgs-train reads it")
    model: Path = required("the model")


@dataclass(frozen=True, slots=True, eq=False)
class Case:
    trainer: Trainer
    target: FrameViews
    before: InMotion
    steps: Parameters  # codec steps of the frame before
    held_out: Sequence[View]

    def warm(self, iterations: int) -> Gaussians:
        short = replace(self.trainer, settings=replace(self.trainer.settings, key_iterations=iterations))
        return short.fit_keyframe(self.target, self.before, self.steps).gaussians

    def scratch(self, iterations: int) -> Gaussians:
        short = replace(self.trainer, settings=replace(self.trainer.settings, first_iterations=iterations))
        return fit_first(short, self.target, None).gaussians


def run(options: Options, lab: Lab) -> Page:
    torch.set_num_threads(1)
    case = open_case(options.scene, options.model)
    case.warm(1)  # compiles
    fast = follow("from the frame before", case.warm, WARM, case.held_out)
    slow = follow("from scratch", case.scratch, SCRATCH, case.held_out)
    return page(len(case.before.gaussians), fast, slow)


def page(rows: int, fast: Sequence[Row], slow: Sequence[Row]) -> Page:
    """What both curves say; `rows`: Gaussians of the frame before."""
    words = [f"The frame before has {rows:,} Gaussians, to which at most {_added(rows, fast):.1f} % are added."]
    met = [(row, one) for row in slow if (one := next((one for one in fast if one["psnr"] >= row["psnr"]), None))]
    if met:
        row, first = met[-1]
        words.insert(
            0,
            f"What a fit from scratch shows after {row['seconds']:.1f} s ({row['psnr']:.1f} dB), one from the frame "
            f"before shows after {first['seconds']:.1f} s, {row['seconds'] / first['seconds']:.1f} times sooner.",
        )
    else:
        words.insert(0, "No fit from the frame before shows what one from scratch does.")
    return Page([Section(" ".join(words))], data=[Table("keyframe", [*fast, *slow])])


def _added(rows: int, fast: Sequence[Row]) -> float:
    return float(100 * (max(row["rows"] for row in fast) / rows - 1))


def open_case(scene_folder: Path, model_folder: Path) -> Case:
    """The first keyframe of a model after frame 0. Raises ConfigError where it has none."""
    model = read_model(model_folder)
    if len(model.record.keyframes()) < 2:
        raise ConfigError(f"{model.folder}: expected a keyframe after frame 0, got none")
    frame = model.record.keyframes()[1]
    settings = settings_from_table(model.record.settings)
    scene = with_held_out(in_step(open_scene(scene_folder), known_offsets(model_folder) or {}), None)
    first = First(model.read(0), model.record.exposure)
    capture = rested(Capture.of(scene, settings, "cpu")).with_first(first)
    before, pictures = frame_before(model, frame), capture.pictures
    steps = capture.trainer.steps(before.gaussians, pictures.train(frame - 1))
    held_out = [view for view in pictures.held_out(frame) if not view.after]
    return Case(capture.trainer, capture.target(frame, frame - 1), before, steps, held_out)


def follow(name: str, fit: Callable[[int], Gaussians], counts: Sequence[int], held_out: Sequence[View]) -> list[Row]:
    curve = []
    for count in counts:
        took, g = seconds_of(lambda n=count: fit(n))  # type: ignore[misc]
        psnr = mean_psnr(g, held_out)
        curve.append({"fitted": name, "iterations": count, "seconds": took.cpu, "psnr": psnr, "rows": len(g)})
    return curve
