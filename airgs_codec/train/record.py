"""What a training run leaves behind, and what it needs to go on: the model folder.

    000000.ply ...    frames, float32 as they were trained
    sequence.json     frame rate and keyframes; transforms.json  cameras at training size
    usage.npz         usage of every Gaussian, when the run is complete
    networks-T.npz    weights of the MLPs after frame T, the last one, while there are frames to come
    training.json     settings and a record of every finished frame; written last, so that it names only whole frames

A run that was killed goes on behind the last record. All that the next frame depends on is in these files.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from airgs_codec._files import PART_SUFFIX, atomic_path, write_json
from airgs_codec.errors import ConfigError, SceneError
from airgs_codec.scene.gaussians import Gaussians
from airgs_codec.scene.ply import read_ply, write_ply
from airgs_codec.scene.sequence import USAGE_NAME
from airgs_codec.scene.usage import Usage, save_usage
from airgs_codec.train.settings import TrainSettings

RECORD_NAME = "training.json"
VERSION = 1


@dataclass(frozen=True, slots=True)
class FrameRecord:
    """One trained frame."""

    frame: int
    kind: str  # first | frame | key
    gaussians: int
    added: int  # by a keyframe
    psnr: float  # dB, mean over training views
    held_out_psnr: float | None  # dB, mean over held-out views; None: there are none
    held_out_ssim: float | None
    rejected_psnr: float | None  # of the fit in the old group, where a keyframe took its place
    static: dict[str, float]  # share of each attribute's channels that changed by less than half a codec step
    seconds: float


@dataclass(slots=True)
class Record:
    """A run so far."""

    scene: dict[str, Any]  # what must not change between sessions
    settings: dict[str, Any]
    frames: list[FrameRecord] = field(default_factory=list)
    total: int = 0  # frames of the whole run
    exposure: dict[str, list[float]] = field(default_factory=dict)  # camera -> gains, offsets

    @property
    def complete(self) -> bool:
        """Whether every frame is there."""
        return len(self.frames) == self.total

    def keyframes(self) -> list[int]:
        """Frames that start a group."""
        return [f.frame for f in self.frames if f.kind != "frame"]

    def group_start(self) -> int:
        """First frame of the last group."""
        return self.keyframes()[-1]


class Model:
    """The model folder of a run."""

    def __init__(self, folder: Path, record: Record) -> None:
        """`record` as `open_model` gives it."""
        self.folder = folder
        self.record = record

    def read(self, frame: int) -> Gaussians:
        """A finished frame."""
        return read_ply(self._path(frame))

    def commit(self, g: Gaussians, frame: FrameRecord, networks: Mapping[str, np.ndarray] | None, fps: str) -> None:
        """Keep a finished frame; from here on the run goes on behind it."""
        with atomic_path(self._path(frame.frame)) as temporary:
            write_ply(temporary, g)
        if networks is not None:
            with atomic_path(self._networks(frame.frame)) as temporary:
                _save(temporary, networks)
        self.record.frames.append(frame)
        settings = {"fps": float(fps) if "/" not in fps else fps, "keyframes": self.record.keyframes()}
        write_json(self.folder / "sequence.json", settings)
        self.write_record()
        if frame.frame:
            self._networks(frame.frame - 1).unlink(missing_ok=True)

    def write_record(self) -> None:
        """Keep what is known; the folder is this run's from then on."""
        write_json(self.folder / RECORD_NAME, {"version": VERSION, **asdict(self.record)})

    def networks(self) -> dict[str, np.ndarray]:
        """Weights after the last finished frame. Raises SceneError when they are not there."""
        path = self._networks(self.record.frames[-1].frame)
        try:
            with path.open("rb") as opened, np.load(opened, allow_pickle=False) as file:
                return {name: file[name] for name in file.files}
        except (OSError, ValueError, EOFError) as error:
            raise SceneError(f"{path}: expected the networks of an unfinished run: {error}") from error

    def finish(self, usage: Mapping[tuple[int, int], Usage]) -> None:
        """Keep the usage of each group of a complete run; weights that nothing needs any more go."""
        save_usage(self.folder / USAGE_NAME, usage)
        self._networks(self.record.frames[-1].frame).unlink(missing_ok=True)

    def finished(self) -> bool:
        """Whether nothing is left to do."""
        return self.record.complete and (self.folder / USAGE_NAME).is_file()

    def _path(self, frame: int) -> Path:
        return self.folder / f"{frame:06d}.ply"

    def _networks(self, frame: int) -> Path:
        return self.folder / f"networks-{frame:06d}.npz"


def open_model(folder: Path, scene: dict[str, Any], settings: TrainSettings, total: int, resume: bool) -> Model:
    """A new model folder, or with `resume` the one that is there.

    Raises ConfigError when there is something in `folder` that would be lost, or that another run has made.
    """
    record = Record(_as_json(scene), _as_json(settings.table()), total=total)
    if folder.exists() and not folder.is_dir():
        raise ConfigError(f"{folder}: expected a folder for the model, got a file")
    path = folder / RECORD_NAME
    if path.is_file():
        if not resume:
            raise ConfigError(f"{folder}: there is a training run already; --resume goes on with it")
        known = _read(path)
        for what in ("settings", "scene"):
            _same(folder, getattr(known, what), getattr(record, what))
        if len(known.frames) > total:
            raise ConfigError(f"{folder}: expected at most {total} finished frames, got {len(known.frames)}")
        record.frames, record.exposure = known.frames, known.exposure
    elif folder.is_dir() and any(p for p in folder.iterdir() if not p.name.startswith(".")):
        raise ConfigError(f"{folder}: expected a new folder or a training run, got a folder with other files")
    folder.mkdir(parents=True, exist_ok=True)
    for leftover in folder.glob(f".*{PART_SUFFIX}"):
        leftover.unlink()
    for stray in sorted(folder.glob("*.ply"))[len(record.frames) :]:  # finished, but killed before the record was
        stray.unlink()
    if not record.complete:
        (folder / USAGE_NAME).unlink(missing_ok=True)
    model = Model(folder, record)
    model.write_record()
    return model


def write_cameras(folder: Path, data: dict[str, Any]) -> None:
    """Keep the cameras of a run as transforms.json."""
    write_json(folder / "transforms.json", data)


def _same(folder: Path, before: dict[str, Any], now: dict[str, Any]) -> None:
    for name in sorted({*before, *now}):
        if before.get(name) != now.get(name):
            raise ConfigError(
                f"{folder}: the run there has {name} {json.dumps(before.get(name))}, not {json.dumps(now.get(name))}"
            )


def _read(path: Path) -> Record:
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
        if data.pop("version") != VERSION:
            raise ValueError("another version")
        data["frames"] = [FrameRecord(**frame) for frame in data["frames"]]
        return Record(**data)
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise SceneError(f"{path}: expected the record of a training run: {error}") from error


def _as_json(data: dict[str, Any]) -> dict[str, Any]:
    """`data` as it comes back from a file; infinity is a word there."""

    def plain(value: Any) -> Any:
        if isinstance(value, dict):
            return {k: plain(v) for k, v in value.items()}
        if isinstance(value, list | tuple):
            return [plain(v) for v in value]
        return "inf" if isinstance(value, float) and math.isinf(value) else value

    return {name: plain(value) for name, value in data.items()}


def _save(path: Path, arrays: Mapping[str, np.ndarray]) -> None:
    with path.open("wb") as file:
        np.savez(file, allow_pickle=False, **arrays)
