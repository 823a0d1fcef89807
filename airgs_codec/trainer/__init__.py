"""Multi-view video, or frames of Gaussians that share no rows -> Gaussians that move (needs torch)."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import TYPE_CHECKING, Any

from airgs_codec._arguments import argument, path_argument
from airgs_codec.errors import ConfigError
from airgs_codec.places.whole import expect_folder_name
from airgs_codec.progress import Progress, silent, told
from airgs_codec.scene.sequence import GaussianSequence, open_sequence
from airgs_codec.trainer.data.multiview import MultiviewScene, with_held_out
from airgs_codec.trainer.data.readers import has_gaussians, open_scene
from airgs_codec.trainer.settings import TrainSettings

if TYPE_CHECKING:  # it imports torch
    from airgs_codec.trainer.record import Model

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
) -> Model:
    """Train a multi-view scene, open or at a path, into a model folder, which `open_sequence` opens.

    Cameras of a scene at a path that are not in step are matched; a scene that is open is trained as it is. A sequence
    of Gaussians, open or where `open_sequence` opens it, whose rows are not the same from frame to frame is tracked:
    Gaussians that move are fitted to pictures that are drawn of it.

    `folder`: by default SCENE.gaussians beside the scene. `settings`: by default those of `airgs-train` on the device.
    `resume`: go on where a run in the folder ended. `device`: auto, cpu or cuda. `progress`: a function, or a class of
    bars such as tqdm.auto.tqdm. Finished frames stay whatever happens, and a run that was stopped and resumed ends with
    the same files as one that was not.

    Raises SceneError for pictures that cannot be used and frames that cannot be tracked, ConfigError for a folder that
    holds something else, a device that is not there and a missing torch, and TrainingError when a loss is not finite or
    a frame shows nothing.
    """
    require_torch()
    from airgs_codec.render.backend import open_renderer
    from airgs_codec.trainer.data.sync import find_offsets, in_step
    from airgs_codec.trainer.pipeline import open_run, train_frames
    from airgs_codec.trainer.record import known_offsets
    from airgs_codec.trainer.track import pictured, track_settings

    if settings is not None:
        argument("settings", settings, TrainSettings, "TrainSettings")
    words = "a multi-view scene, a sequence of Gaussians, or the path of one"
    opened = scene if isinstance(scene, GaussianSequence) else argument("scene", scene, MultiviewScene, words, _open)
    renderer, tell = open_renderer(device), told(progress)
    place = Path(scene) if isinstance(scene, (str, Path)) else None
    if isinstance(opened, GaussianSequence):
        model, usual = model_folder(place or opened.folder, folder), track_settings(opened)
        views = pictured(opened, renderer)
    else:
        model, usual = model_folder(opened.path, folder), default_settings(renderer.device)
        known = known_offsets(model) if resume else None
        offsets = {} if not place else find_offsets(opened, progress=tell) if known is None else known
        views = in_step(opened, offsets) if place else opened
    run = open_run(views, model, settings or usual, resume=resume, device=renderer.device)
    for _ in train_frames(run, tell):
        pass
    return run.model


def _open(place: str | Path) -> Any:
    return open_sequence(place) if has_gaussians(place) else with_held_out(open_scene(Path(place)), None)


def require_torch() -> None:
    """Raises ConfigError where torch is not installed."""
    if importlib.util.find_spec("torch") is None:
        raise ConfigError("training needs torch: pip install 'airgs-codec[train]'")


def model_folder(scene: Path, folder: str | Path | None = None) -> Path:
    """The model folder of a scene, SCENE.gaussians unless another one is named. Raises ConfigError."""
    resolved = scene.resolve()  # "." has no name of its own
    place = resolved.with_name(resolved.name + ENDING) if folder is None else Path(path_argument("folder", folder))
    expect_folder_name(place, ENDING)
    return place


def default_settings(device: str) -> TrainSettings:
    """The settings of a run on cpu or cuda unless others are named."""
    if device == "cpu":
        return TrainSettings()
    return TrainSettings(deltas="mlp+residual", iteration_views=CUDA_VIEWS)
