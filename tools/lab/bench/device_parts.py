"""The parts of the experiment on devices, each for a process of its own: pictures that must agree, a fit, an encode.

Each function gives the rows of its table. `measured` calls it, and says how much memory of the GPU it took.
"""

from __future__ import annotations

import math
import os
import tempfile
from collections.abc import Callable
from dataclasses import asdict, astuple, dataclass, replace
from pathlib import Path
from statistics import mean, median

import numpy as np
from numpy.typing import NDArray

from airgs_codec.encoder.publish import encode
from airgs_codec.encoder.settings import EncodeSettings
from airgs_codec.render import read_cameras
from airgs_codec.render.backend import CPU, Loaded, open_renderer
from airgs_codec.render.cpu import RasterInputs
from airgs_codec.scene.camera import Camera
from airgs_codec.scene.gaussians import SH_REST, Gaussians
from airgs_codec.scene.sequence import open_sequence
from airgs_codec.trainer import default_settings, train
from airgs_codec.trainer.data.multiview import MultiviewScene, with_held_out
from airgs_codec.trainer.data.readers import open_scene
from airgs_codec.trainer.record import RECORD_NAME, FrameRecord, read_model
from airgs_codec.trainer.settings import TrainSettings
from tools.lab import Row, seconds_of

FRAMES, KEYFRAME = 5, 3  # of a scene that are fitted, and the first of them in a second group
MIB = 1 << 20


@dataclass(frozen=True, slots=True)
class Difference:
    worst: float  # sample of the picture; pixels flip where alpha is next to 1/255
    mean: float
    gradients: float
    total: float
    peak: float
    hits: float

    def good(self) -> bool:
        return all(value <= limit for value, limit in zip(astuple(self), astuple(LIMITS), strict=True))


LIMITS = Difference(worst=5e-3, mean=1e-5, gradients=1e-2, total=1e-3, peak=1e-2, hits=1e-2)


def compare(a: Loaded, b: Loaded, camera: Camera) -> Difference:
    """The difference of two renderers with the same Gaussians, for a loss of random weights."""
    apart = np.abs(a.draw(camera).rgb - b.draw(camera).rgb)
    pull = np.random.default_rng(0).normal(size=apart.shape).astype(np.float32)
    (seen, by), (other, by_other) = (side.contribution_and_gradients(camera, pull) for side in (a, b))
    gradients = float(np.max([_relative(getattr(by, n), getattr(by_other, n)) for n in RasterInputs._fields]))
    weights = [_relative(getattr(seen, n), getattr(other, n)) for n in ("total", "peak", "hits")]
    return Difference(float(apart.max()), float(apart.mean()), gradients, *weights)


def _relative(a: NDArray[np.generic], b: NDArray[np.generic]) -> float:
    wanted = np.asarray(a, np.float64)
    norm = float(np.linalg.norm(wanted))
    apart = float(np.linalg.norm(wanted - np.asarray(b, np.float64)))
    return apart / norm if norm else apart


def measured(function: Callable[..., list[Row]], device: str, *arguments: object) -> tuple[list[Row], float | None]:
    """The rows that a part gives on a device, and the most MiB of the GPU that torch had; None: it is the CPU."""
    open_renderer(device)
    rows = function(device, *arguments)
    if device == "cpu":
        return rows, None
    import torch

    return rows, torch.cuda.max_memory_allocated() / MIB


def pictures(device: str, name: str, folder: Path, cameras: int) -> list[Row]:
    """Compare what the first cameras see of the middle frame of a sequence, without SH, as it is, and with all bands.

    One row for each picture, with the milliseconds that a second one takes.
    """
    sequence, renderer = open_sequence(folder), open_renderer(device)
    g = sequence.read(len(sequence) // 2)
    rows: list[Row] = []
    for bands in (g.with_degree(0), g, _with_all_bands(g)):
        a, b = CPU.load(bands), renderer.load(bands)
        for camera in sequence.cameras[:cameras]:
            difference = compare(a, b, camera)
            cpu_ms, its_ms = (1e3 * seconds_of(lambda s=side, c=camera: s.draw(c))[0].wall for side in (a, b))  # type: ignore[misc]
            seen: Row = {"scene": name, "SH": bands.sh_degree, "camera": camera.name, **asdict(difference)}
            rows.append(seen | {"CPU, ms": cpu_ms, f"{device}, ms": its_ms})
    return rows


def _with_all_bands(g: Gaussians) -> Gaussians:
    noise = 0.1 * np.random.default_rng(0).normal(size=(len(g), SH_REST[-1], 3))
    return replace(g, sh_rest=noise.astype(np.float32))


@dataclass(frozen=True, slots=True)
class Fit:
    scene: Path
    settings_of: str  # the device whose default settings they are
    effort: float  # times the iterations of those

    def settings(self, views: int) -> TrainSettings:
        """The settings for so many training views: a keyframe where it is wanted, and nowhere else."""
        base = default_settings(self.settings_of)
        counts = (base.iterations_from_scratch(views), base.key_iterations, base.frame_iterations)
        first, key, frame = (max(1, round(self.effort * count)) for count in counts)
        return replace(
            base,
            first_iterations=first,
            key_iterations=key,
            frame_iterations=frame,
            group_frames=KEYFRAME,
            min_psnr_db=0.0,
            max_drop_db=math.inf,
        )

    def open(self) -> MultiviewScene:
        """The frames that are fitted. Raises SceneError."""
        count = min(FRAMES, len(open_scene(self.scene)))
        return with_held_out(open_scene(self.scene, frames=(0, count)), None)


def fit(device: str, asked: Fit, folder: Path) -> list[Row]:
    """Fit the frames into a model folder, in pictures of full size; the row is that of `fitted`."""
    scene = asked.open()
    views = sum(not camera.held_out for camera in scene.cameras)
    train(scene, folder, asked.settings(views), device=device)
    return fitted(device, asked, folder)


def fitted(device: str, asked: Fit, folder: Path) -> list[Row]:
    """A row of what a model folder has, which may be a part of the frames; none where there is no frame yet."""
    record = read_model(folder).record if (folder / RECORD_NAME).is_file() else None
    if record is None or not record.frames:
        return []
    frames, s = record.frames, record.settings
    held_out = [f.held_out_psnr for f in frames if f.held_out_psnr is not None]
    size = max((camera.width, camera.height) for camera in read_cameras(folder))
    row: Row = {"scene": asked.scene.name, "device": device, "pictures": f"{size[0]} x {size[1]}"}
    counts = (s["first_iterations"], s["key_iterations"], s["frame_iterations"])
    row["iterations"] = ", ".join(map(str, counts))
    for name, kind in (("first frame, s", "first"), ("keyframe, s", "key"), ("frame in a group, s", "frame")):
        row[name] = _seconds(frames, kind)
    quality = {"PSNR, dB": mean(f.psnr for f in frames), "held-out, dB": mean(held_out) if held_out else None}
    return [row | quality | {"frames": len(frames), "Gaussians": frames[-1].gaussians}]


def _seconds(frames: tuple[FrameRecord, ...], kind: str) -> float | None:
    """The median of what frames of a kind took; None: there is none."""
    took = [frame.seconds for frame in frames if frame.kind == kind]
    return median(took) if took else None


def encoded(device: str, name: str, model: Path, settings: EncodeSettings) -> list[Row]:
    sequence = open_sequence(model)
    with tempfile.TemporaryDirectory(dir=model.parent) as folder:
        os.environ["XDG_CACHE_HOME"] = folder  # calibrations; gsplat's kernels are loaded already
        took, report = seconds_of(lambda: encode(sequence, f"{folder}/package", replace(settings, device=device)))
    m = report.manifest
    top, all_rungs = m.bytes_of(m.rung_files(0, 0)) / m.frames, m.media_bytes() / m.frames
    times = {"calibration, s": report.calibrate_s, "encoding, s": report.encode_s, "measuring, s": report.measure_s}
    row: Row = {"scene": name, "device": device, "frames": m.frames, "seconds": took.wall, **times}
    return [row | {"bytes a frame": round(top), "with all rungs": round(all_rungs)}]
