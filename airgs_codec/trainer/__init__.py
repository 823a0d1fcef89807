"""Multi-view video, or frames of Gaussians that share no rows -> Gaussians that move (needs torch)."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import TYPE_CHECKING

from airgs_codec._arguments import argument, described, path_argument
from airgs_codec.errors import ConfigError
from airgs_codec.places.whole import expect_folder_name
from airgs_codec.progress import Progress, as_reporter, silent
from airgs_codec.scene.sequence import GaussianSequence, open_sequence
from airgs_codec.trainer.data.multiview import MultiviewScene, with_held_out
from airgs_codec.trainer.data.readers import has_gaussians, open_scene
from airgs_codec.trainer.settings import TrainSettings

if TYPE_CHECKING:  # it imports torch
    from airgs_codec.trainer.record import ModelFolder

ENDING = ".gaussians"  # of a model folder, where it has one
CUDA_VIEWS = 4  # an iteration sees on a GPU, which a single picture does not fill


def train(
    scene: MultiviewScene | GaussianSequence | str | Path,
    folder: str | Path | None = None,
    settings: TrainSettings | None = None,
    *,
    resume: bool = False,
    device: str = "auto",
    progress: Progress | type = silent,
) -> ModelFolder:
    """Train a multi-view scene, open or at a path, into a model folder, which `open_sequence` opens.

    Cameras of a scene at a path that are not synchronous are matched; an open scene is trained as it is. A sequence of
    Gaussians, open or where `open_sequence` opens it, whose rows are not the same from frame to frame is tracked:
    Gaussians that move are fitted to pictures that are drawn of it.

    `folder`: by default SCENE.gaussians next to the scene. `settings`: by default those of `airgs-train` on the device.
    `resume`: go on where a run in the folder ended. `device`: auto, cpu or cuda. `progress`: a function, or a class of
    bars such as tqdm.auto.tqdm. Finished frames stay whatever happens, and a run that was stopped and resumed ends with
    the same files as one that was not.

    Raises SceneError for pictures that cannot be used and frames that cannot be tracked, ConfigError for a folder that
    holds something else, a missing device or torch, and TrainingError when a loss is not finite or a frame shows
    nothing.
    """
    require_torch()
    from airgs_codec.render.backend import open_renderer
    from airgs_codec.trainer.data.sync import find_offsets, in_step
    from airgs_codec.trainer.pipeline import open_run, train_frames
    from airgs_codec.trainer.record import known_offsets
    from airgs_codec.trainer.track import pictured, track_settings

    if settings is not None:
        argument("settings", settings, TrainSettings, "TrainSettings")
    renderer, report = open_renderer(device), as_reporter(progress)
    place = Path(scene) if isinstance(scene, (str, Path)) else None
    if isinstance(scene, (str, Path)):
        scene = open_sequence(scene) if has_gaussians(scene) else with_held_out(open_scene(Path(scene)), None)
    if isinstance(scene, GaussianSequence):
        model, usual = model_folder(place or scene.folder, folder), track_settings(scene)
        scene = pictured(scene, renderer)
    elif isinstance(scene, MultiviewScene):
        model, usual = model_folder(scene.path, folder), default_settings(renderer.device)
        if place:
            known = known_offsets(model) if resume else None
            scene = in_step(scene, find_offsets(scene, progress=report) if known is None else known)
    else:
        raise ConfigError(f"scene: expected a multi-view scene, Gaussians, or the path of one, got {described(scene)}")
    run = open_run(scene, model, settings or usual, resume=resume, device=renderer.device)
    for _ in train_frames(run, report):
        pass
    return run.model


def require_torch() -> None:
    """Raise ConfigError where torch is not installed."""
    if importlib.util.find_spec("torch") is None:
        raise ConfigError("training needs torch: pip install 'airgs-codec[train]'")


def model_folder(scene: Path, folder: str | Path | None = None) -> Path:
    """Return the model folder of a scene, SCENE.gaussians unless another one is named. Raises ConfigError."""
    resolved = scene.resolve()  # "." has no name of its own
    place = resolved.with_name(resolved.name + ENDING) if folder is None else Path(path_argument("folder", folder))
    expect_folder_name(place, ENDING)
    return place


def default_settings(device: str) -> TrainSettings:
    """Return the settings of a run on cpu or cuda unless others are named."""
    if device == "cpu":
        return TrainSettings()
    return TrainSettings(deltas="mlp+residual", frame_iterations=300, iteration_views=CUDA_VIEWS)
