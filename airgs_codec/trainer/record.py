"""The model folder: the results of a training run, and all that it needs to be resumed.

    000000.ply ...    frames, float32 as they were trained
    sequence.json     frame rate and keyframes; transforms.json  cameras at training size
    usage.npz         usage of every Gaussian, when the run is complete
    networks-T.npz    weights of the MLPs after frame T, the last one, while there are frames to come
    training.json     settings and a record of every finished frame; written last, so that it names only whole frames

A run that was killed is resumed after the last record. All that the next frame depends on is in these files.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from fractions import Fraction
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from airgs_codec.errors import ConfigError
from airgs_codec.places.whole import atomic_path, remove_leftovers, to_json, write_json
from airgs_codec.scene.beside import USAGE_NAME, Settings, Usage, exact_number, frame_rate, save_usage, write_settings
from airgs_codec.scene.camera import BLACK, OPENGL_TO_OPENCV, Background, Camera, cameras_from
from airgs_codec.scene.files import expecting
from airgs_codec.scene.formats.ply import read_ply, write_ply
from airgs_codec.scene.frames import ZERO, in_world, narrowed
from airgs_codec.scene.gaussians import Gaussians
from airgs_codec.trainer.data.multiview import MultiviewScene
from airgs_codec.trainer.data.pictures import Exposure
from airgs_codec.trainer.settings import BUDGET, TrainSettings

RECORD_NAME = "training.json"
CAMERAS_NAME = "transforms.json"
MODEL_VERSION = 4

Span = tuple[int, int]  # frames [start, stop)


@dataclass(frozen=True, slots=True)
class FrameRecord:
    """One trained frame. Each PSNR is the mean over views of each view's PSNR."""

    frame: int
    kind: str  # first | frame | keyframe
    gaussians: int
    added: int  # by a keyframe
    psnr: float  # dB, training views
    held_out_psnr: float | None  # dB, held-out views; None: there are none
    held_out_matched: float | None  # dB, held-out views, each channel with the gain and offset that show most
    held_out_ssim: float | None  # mean over held-out views
    rejected_psnr: float | None  # dB, training views: of the other fit, where a keyframe was tried too
    seconds: float
    cleared: int = 0  # Gaussians that hung in open space and were removed


@dataclass(frozen=True, slots=True, eq=False)
class TrainedFrame:
    gaussians: Gaussians
    record: FrameRecord
    networks: Mapping[str, np.ndarray] | None = None  # their weights after the frame; None: frames move without
    exposure: Exposure = field(default_factory=dict)  # that was found at the first frame


@dataclass(frozen=True, slots=True)
class Record:
    scene: dict[str, Any]  # what must not change between sessions
    settings: dict[str, Any]  # `TrainSettings.table`, through JSON
    total: int  # frames of the whole run
    fps: str  # frames a second, as a fraction
    frames: tuple[FrameRecord, ...] = ()  # the finished ones
    exposure: Exposure = field(default_factory=dict)

    @staticmethod
    def of(scene: MultiviewScene, background: Background, settings: TrainSettings) -> Record:
        cameras = [f"{c.name} {c.split} {c.width}x{c.height} near {c.near:g}" for c in scene.cameras]
        given = scene.given is not None
        same: dict[str, Any] = {"name": scene.path.resolve().name, "cameras": cameras, "tracked": given}
        same |= {"first picture": Path(str(scene.frames[0][0].source)).name, "background": list(background)}
        same |= {"origin": [] if scene.origin == ZERO else list(scene.origin), "offsets": dict(scene.offsets)}
        same["notes"] = list(scene.notes)
        found = {name: value for name, value in same.items() if value}
        return Record(found, settings.table(), len(scene), str(scene.fps))

    @property
    def complete(self) -> bool:
        return len(self.frames) == self.total

    def keyframes(self) -> list[int]:
        return [f.frame for f in self.frames if f.kind != "frame"]

    def spans(self) -> list[Span]:
        return list(pairwise([*self.keyframes(), len(self.frames)]))

    def quality(self) -> str:
        """Return how near the finished frames are to their pictures, a sentence that packages of them repeat."""
        shown, keys = [f.psnr for f in self.frames], len(self.keyframes())
        if self.scene.get("tracked"):
            lowest, views = int(np.argmin(shown)), len(self.scene["cameras"])
            words = f"tracked: {keys} key{'s' * (keys > 1)} for {len(shown)} frames; against what was given "
            words += f"{np.mean(shown):.1f} dB in {views} views"
            return f"{words}, {shown[lowest]:.1f} at frame {lowest}, the lowest"
        unseen = [(f.held_out_psnr, f.held_out_matched) for f in self.frames if f.held_out_psnr is not None]
        held_out, matched = np.mean(np.array(unseen, np.float64), axis=0) if unseen else (0.0, 0.0)
        words = f"{np.mean(shown):.1f} dB to the pictures it was trained on"
        words += f" and {held_out:.1f} dB to those held out" if unseen else ""
        words += f", {matched:.1f} with their exposure matched" if unseen and self.exposure else ""
        return f"qualities are those of the coding: the trained model is itself at {words}"

    def warnings(self) -> list[str]:
        low, within = self.settings["min_psnr_db"], self.settings["densify"] == BUDGET
        tried = (f for f in self.frames if f.psnr < low and (f.kind != "frame" or f.rejected_psnr is not None))
        if self.total == 1 or (one := next(tried, None)) is None:
            return []
        growth = f"up to {100 * self.settings['max_growth']:g} % of Gaussians" if within else "Gaussians"
        remedy = f"lower --min-psnr or {'raise --budget' if within else 'train for more --iterations'}"
        fault = f"frame {one.frame}: {one.psnr:.1f} dB in training views, no fit reaches the {low:g} dB of --min-psnr"
        return [f"{fault}; every frame like it takes long and may add {growth}: {remedy}"]

    def group_start(self, frame: int) -> int:
        """Return the first frame of the group of the frame before `frame`, which is at least 1."""
        return max(start for start in self.keyframes() if start < frame)


class ModelFolder:
    def __init__(self, folder: Path, record: Record) -> None:
        """`record`: as the folder has it; see `open_model` and `read_model`."""
        self.folder, self.record = folder, record
        self._origin = np.array(record.scene.get("origin", ZERO), np.float64)

    def read(self, frame: int) -> Gaussians:
        return narrowed(read_ply(self._path(frame)), self._origin, self._path(frame))

    def commit(self, trained: TrainedFrame) -> FrameRecord:
        """Write the next frame, after which the run can be resumed, and return its record."""
        frame, shown = trained.record, trained.gaussians
        with atomic_path(self._path(frame.frame)) as temporary:
            write_ply(temporary, in_world(shown, self._origin) if self._origin.any() else shown)
        if trained.networks is not None:
            with atomic_path(self._networks(frame.frame)) as temporary, temporary.open("wb") as file:
                np.savez(file, allow_pickle=False, **trained.networks)
        found = dict(trained.exposure or self.record.exposure)
        self.record = replace(self.record, frames=(*self.record.frames, frame), exposure=found)
        self.write_record()
        if frame.frame:
            self._networks(frame.frame - 1).unlink(missing_ok=True)
        return frame

    def cut(self, count: int) -> None:
        self.record = replace(self.record, frames=self.record.frames[:count])
        self.write_record()
        self.remove_leftovers()

    def discard(self) -> None:
        """Remove the folder of a run that has no frame yet, unless something else is in it."""
        for name in (RECORD_NAME, CAMERAS_NAME):
            (self.folder / name).unlink(missing_ok=True)
        if not any(self.folder.iterdir()):
            self.folder.rmdir()

    def write_record(self) -> None:
        """Write sequence.json, and last the record, by which the folder is this run's."""
        record = self.record
        if record.frames:
            red, green, blue = record.scene.get("background", BLACK)
            notes = (*record.scene.get("notes", ()), record.quality())
            keyframes = tuple(record.keyframes())
            write_settings(self.folder, Settings(Fraction(record.fps), keyframes, (red, green, blue), notes))
        write_json(self.folder / RECORD_NAME, {"version": MODEL_VERSION, **asdict(record)})

    def write_cameras(self, cameras: Sequence[Camera]) -> None:
        """Write the cameras of the run as a nerfstudio transforms.json without pictures."""
        frames = []
        for c in cameras_from(-self._origin, cameras):
            matrix = np.linalg.inv(c.world_to_camera) @ OPENGL_TO_OPENCV
            entry = {"camera": c.name, "split": c.split, "file_path": "", "w": c.width, "h": c.height}
            entry |= {"fl_x": c.fx, "fl_y": c.fy, "cx": c.cx, "cy": c.cy} | ({"near": c.near} if c.near else {})
            frames.append({**entry, "transform_matrix": matrix.tolist()})
        fps = float(Fraction(self.record.fps))
        write_json(self.folder / CAMERAS_NAME, {"camera_model": "PINHOLE", "fps": fps, "frames": frames})

    def networks(self) -> dict[str, np.ndarray]:
        """Read the weights after the last finished frame. Raises SceneError when they are missing."""
        path = self._networks(self.record.frames[-1].frame)
        with expecting(path, "the networks of an unfinished run"), np.load(path, allow_pickle=False) as file:
            return {name: file[name] for name in file.files}

    def finish(self, usage: Mapping[Span, Usage]) -> None:
        """Write the usage of each group of a complete run, and remove the weights."""
        save_usage(self.folder / USAGE_NAME, usage)
        self._networks(self.record.frames[-1].frame).unlink(missing_ok=True)

    def finished(self) -> bool:
        return self.record.complete and (self.folder / USAGE_NAME).is_file()

    def remove_leftovers(self) -> None:
        remove_leftovers(self.folder)
        for stray in sorted(self.folder.glob("*.ply"))[len(self.record.frames) :]:  # written, but not recorded
            stray.unlink()
        if not self.record.complete:
            (self.folder / USAGE_NAME).unlink(missing_ok=True)

    def _path(self, frame: int) -> Path:
        return self.folder / f"{frame:06d}.ply"

    def _networks(self, frame: int) -> Path:
        return self.folder / f"networks-{frame:06d}.npz"


def open_model(folder: Path, wanted: Record, resume: bool) -> ModelFolder:
    """Open the model folder of the `wanted` run, new or resumed. Raises ConfigError for one with something else."""
    new = replace(wanted, scene=json.loads(to_json(wanted.scene)), settings=json.loads(to_json(wanted.settings)))
    if folder.exists() and not folder.is_dir():
        raise ConfigError(f"{folder}: expected a folder for the model, got a file")
    if (folder / RECORD_NAME).is_file():
        if not resume:
            raise ConfigError(f"{folder}: there is a training run already, which resume (--resume) goes on with")
        new = _continued(folder, read_model(folder).record, new)
    elif folder.is_dir() and any(p for p in folder.iterdir() if not p.name.startswith(".")):
        raise ConfigError(f"{folder}: expected a new folder or a training run, got a folder with other files")
    folder.mkdir(parents=True, exist_ok=True)
    model = ModelFolder(folder, new)
    model.remove_leftovers()
    model.write_record()
    return model


def read_model(folder: Path) -> ModelFolder:
    """Open the model folder of a run, finished or not. Raises SceneError when it has no record that can be read."""
    path = folder / RECORD_NAME
    with expecting(path, "the record of a training run"):
        data = json.loads(path.read_text(encoding="utf-8"))
        version = data.pop("version")
        if version != MODEL_VERSION:
            raise ValueError(f"version {version} instead of {MODEL_VERSION}")
        frame_rate(str(path), exact_number(data["fps"]))
        data["frames"] = tuple(FrameRecord(**frame) for frame in data["frames"])
        return ModelFolder(folder, Record(**data))


def known_offsets(folder: Path) -> Mapping[str, float] | None:
    """Return by how many frames cameras of the run in a folder were late; None without a run. Raises SceneError."""
    return dict(read_model(folder).record.scene.get("offsets", {})) if (folder / RECORD_NAME).is_file() else None


def _continued(folder: Path, known: Record, new: Record) -> Record:
    for before, now in ((known.settings, new.settings), (known.scene, new.scene)):
        for name in sorted({*before, *now}):
            if before.get(name) != now.get(name):
                had, has = json.dumps(before.get(name)), json.dumps(now.get(name))
                raise ConfigError(f"{folder}: the run there has {name} {had}, not {has}")
    if len(known.frames) > new.total:
        raise ConfigError(f"{folder}: expected at most {new.total} finished frames, got {len(known.frames)}")
    return replace(new, frames=known.frames, exposure=known.exposure)
