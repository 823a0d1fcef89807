"""What a baseline is: a trainer whose frames are kept as its own viewer shows them, with what that viewer fetches.

A run is a folder: NNNNNN.ply of every frame, frames.json with what it cost, and whatever the method keeps to go on.
"""

from __future__ import annotations

import json
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Protocol

import numpy as np

from airgs_codec.errors import ConfigError
from airgs_codec.places.whole import to_json, write_json
from airgs_codec.progress import Progress, silent
from airgs_codec.scene.formats.ply import write_ply
from airgs_codec.scene.gaussians import Gaussians
from airgs_codec.trainer.data.multiview import Points
from airgs_codec.trainer.data.pictures import ScenePictures
from airgs_codec.trainer.fit.losses import mean_psnr, mean_ssim

RECORD = "frames.json"


@dataclass(frozen=True, slots=True, eq=False)
class Footage:
    pictures: ScenePictures
    frames: int
    points: Points | None  # of the first frame; None: the scene has none
    folder: Path  # where the method may keep what it needs to go on, beside the frames
    source: Mapping[str, object] = field(default_factory=dict)  # what tells the pictures from others, as JSON


@dataclass(frozen=True, slots=True, eq=False)
class Shown:
    """A frame as the viewer of the method shows it, after the method's own coding."""

    kind: str  # keyframe | frame
    gaussians: Gaussians
    bytes: int  # that a viewer fetches for it


class Method(Protocol):
    @property
    def name(self) -> str:
        """Its name in tables."""

    @property
    def settings(self) -> dict[str, object]:
        """Return what decides its result besides the footage, as JSON: a run of other settings is another run."""

    def frames(self, footage: Footage, done: int, progress: Progress) -> Iterator[Shown]:
        """The frames from number `done` on; those before it were given by earlier calls and are kept."""


@dataclass(frozen=True, slots=True)
class Frame:
    kind: str
    gaussians: int
    bytes: int
    seconds: float  # of CPU time until it was there: of the first frame those of all that are made together
    psnr: float  # dB, mean over held-out views
    ssim: float  # mean over held-out views


def run_method(method: Method, footage: Footage, progress: Progress = silent) -> list[Frame]:
    """Train a method, keep every frame as it comes, and measure it on the held-out cameras.

    A run that was stopped goes on after its last frame. Its record is written before anything is trained, so that what
    a method keeps by itself is never taken for that of another run. Raises ConfigError for a folder that holds a run of
    another method, other settings or other pictures.
    """
    wanted: dict[str, object] = {"method": method.name, "settings": method.settings}
    wanted |= {"frames": footage.frames, "source": footage.source}
    path = footage.folder / RECORD
    footage.folder.mkdir(parents=True, exist_ok=True)
    frames = _kept(path, wanted)
    if len(frames) == footage.frames:
        return frames
    _keep(path, wanted, frames)
    begun = time.process_time()
    for t, shown in enumerate(method.frames(footage, len(frames), progress), start=len(frames)):
        seconds = round(time.process_time() - begun, 3)
        write_ply(frame_path(footage.folder, t), shown.gaussians)
        views = footage.pictures.held_out(t)
        quality, likeness = mean_psnr(shown.gaussians, views), mean_ssim(shown.gaussians, views)
        rows = len(shown.gaussians)
        frames.append(Frame(shown.kind, rows, shown.bytes, seconds, quality, likeness))
        _keep(path, wanted, frames)
        begun = time.process_time()
    return frames


def frame_path(folder: Path, frame: int) -> Path:
    return folder / f"{frame:06d}.ply"


def mean_bytes(frames: Sequence[Frame]) -> float:
    return float(np.mean([frame.bytes for frame in frames]))


def _keep(path: Path, wanted: dict[str, object], frames: Sequence[Frame]) -> None:
    write_json(path, wanted | {"done": [asdict(frame) for frame in frames]})


def _kept(path: Path, wanted: dict[str, object]) -> list[Frame]:
    if not path.exists():
        return []
    record = json.loads(path.read_text())
    done = [Frame(**entry) for entry in record.pop("done")]
    if record != json.loads(to_json(wanted)):
        raise ConfigError(f"{path}: expected a run of {wanted['method']} with these settings, got {record}")
    return done
