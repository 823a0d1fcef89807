"""What the commands that train share: where a model goes, which device is used, and what is said on the way.

torch is imported only when training begins.
"""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Iterable
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING

from airgs_codec.cli.common import Bar
from airgs_codec.errors import ConfigError
from airgs_codec.train.data.multiview import with_held_out
from airgs_codec.train.data.readers import is_unposed, open_scene
from airgs_codec.train.data.rig import find_poses
from airgs_codec.train.settings import TrainSettings

if TYPE_CHECKING:
    from airgs_codec.train.pipeline import Run
    from airgs_codec.train.record import FrameRecord, Model

CUDA_VIEWS = 4  # an iteration sees on a GPU, which a single picture does not fill


def train_by_default(scene: Path, fps: Fraction | None, device: str, *, quiet: bool) -> Path:
    """The model folder of a multi-view scene, trained as far as it is not yet, with default settings.

    `fps`: frames a second, instead of what the scene says. `device`: auto, cpu or cuda. `quiet`: say nothing.
    """
    require_torch()
    from airgs_codec.render.backend import open_renderer
    from airgs_codec.train.pipeline import open_run

    pose_rig(scene, quiet=quiet)
    views = with_held_out(open_scene(scene, fps=fps), None)
    device = open_renderer(device).device
    run = open_run(views, default_model(scene), default_settings(device), resume=True, device=device)
    return run_training(run, quiet=quiet).folder


def pose_rig(scene: Path, *, frame: int = 0, shared_lens: bool = False, quiet: bool) -> None:
    """Find the poses of a rig that has none (`find_poses`), and say what came of it; other scenes are left alone."""
    if not is_unposed(scene):
        return
    if not quiet:
        print(f"{scene}: videos without poses; COLMAP finds them from frame {frame}, which takes minutes", flush=True)
    bar = Bar(quiet)
    try:
        report = find_poses(scene, frame=frame, shared_lens=shared_lens, progress=bar)
    finally:
        bar.close()
    if not quiet:
        print("\n".join([*report.lines(), f"{scene / 'sparse'}: {report.summary()}"]), flush=True)
    if report.failed:
        names = ", ".join(camera.name for camera in report.failed)
        print(f"warning: trained without cameras that have no pose: {names}", file=sys.stderr)


def run_training(run: Run, *, quiet: bool) -> Model:
    """Train frame after frame with a progress bar; `follow_training` says what is done."""
    from airgs_codec.train.pipeline import train_frames

    bar = Bar(quiet)
    return follow_training(run, train_frames(run, bar), bar, quiet=quiet)


def follow_training(run: Run, records: Iterable[FrameRecord], bar: Bar, *, quiet: bool) -> Model:
    """A line for each frame as it is kept, and the warnings of the run once each."""
    said = set[str]()
    try:
        for record in records:
            bar.close()
            if not quiet:
                print(frame_line(record), flush=True)
            for warning in set(run.model.record.warnings()) - said:
                print(f"warning: {warning}", file=sys.stderr)
                said.add(warning)
    finally:
        bar.close()
    return run.model


def frame_line(r: FrameRecord) -> str:
    """One finished frame in words; PSNR is the mean over training views."""
    held_out = "" if r.held_out_psnr is None else f", held-out {r.held_out_psnr:.2f}"
    kind = {"first": "  first frame", "frame": "", "key": f"  keyframe, {r.added:+,} Gaussians"}[r.kind]
    if r.rejected_psnr is not None:
        other = "as a keyframe" if r.kind == "frame" else "in the old group"
        kind += f"  ({other} {r.rejected_psnr:.2f} dB)"
    static = f", static {100 * sum(r.static.values()) / len(r.static):.0f} %" if r.static else ""
    return f"frame {r.frame:4d}  {r.psnr:.2f} dB{held_out}  {r.gaussians:,} Gaussians{static}  {r.seconds:.1f} s{kind}"


def require_torch() -> None:
    """Raises ConfigError where torch is not installed."""
    if importlib.util.find_spec("torch") is None:
        raise ConfigError("training needs torch: pip install 'airgs-codec[train]'")


def default_model(scene: Path) -> Path:
    """The model folder of a scene unless another one is named."""
    resolved = scene.resolve()  # "." has no name of its own
    return resolved.with_name(resolved.name + ".gaussians")


def default_settings(device: str) -> TrainSettings:
    """The settings of a run on cpu or cuda unless others are named."""
    if device == "cpu":
        return TrainSettings()
    return TrainSettings(deltas="mlp+residual", iteration_views=CUDA_VIEWS)
