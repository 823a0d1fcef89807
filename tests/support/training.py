"""A small scene to train on, settings that train it in seconds, and the models of it that tests share."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from tests.faces import TrainSettings, Work, one_thread, open_run, open_scene, open_store, train, train_in_jobs
from tests.support.multiview_files import write_views
from tests.support.views import appeared, coloured_cloud, joined, moved, ring

SETTINGS = TrainSettings(
    budget=260, capacity=400, sh_degree=0, first_iterations=140, keyframe_iterations=120, frame_iterations=25,
    max_growth=0.4, max_drop_db=3.0,
)  # fmt: skip
CHUNKED = replace(
    SETTINGS, capacity=None, max_growth=9.0, first_iterations=20, keyframe_iterations=10, frame_iterations=4,
    group_frames=3, match_exposure="on", deltas="mlp+residual",
)  # fmt: skip
APPEARS = 3  # frame of `write_blobs`


def write_blobs(folder: Path) -> Path:
    """Five frames; a part moves, and at APPEARS something comes into empty space."""
    g = coloured_cloud(120)
    frames = []
    for t in range(5):
        now = moved(g, slice(0, 20), (0.02 * t, 0.0, 0.0))
        frames.append(joined(now, appeared()) if t >= APPEARS else now)
    write_views(folder, frames, ring(7, size=40, held_out=1), g.means)
    (folder / "ATTRIBUTION.txt").write_text("blobs by nobody\n")
    return folder


def blobs(scene: Path, folder: Path) -> None:
    with one_thread():
        train(open_scene(scene), folder, SETTINGS)


def chunked(scene: Path, folder: Path) -> None:
    """Jobs of two chunks: the model `m` and the `work` that has trained it."""
    with one_thread():
        run = open_run(open_scene(scene), folder / "m", CHUNKED)
        assert [f.frame for f in train_in_jobs(run, Work(None, open_store(folder / "work")))] == [0, 1, 2, 3, 4]


MODELS: dict[str, Callable[[Path, Path], None]] = {"blobs": blobs, "chunked": chunked}


def files(folder: Path) -> tuple[dict[str, bytes], dict[str, object]]:
    """Everything that a run decides; seconds are the machine's."""
    found = {p.name: p.read_bytes() for p in folder.iterdir() if p.name != "training.json"}
    record = json.loads((folder / "training.json").read_text())
    for frame in record["frames"]:
        frame.pop("seconds")
    return found, record
