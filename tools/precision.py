"""The measurements of `work_precision`, a generator of rows for each part of the codec.

PSNR in the notes: packages pool the squared error of views and frames, fits are the mean of dB over views.
"""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

import numpy as np
import torch
from numpy.typing import NDArray

from airgs_codec.coding import escapes
from airgs_codec.coding.roundtrip import encode_and_decode
from airgs_codec.decoder.decode import decode_canonical, decode_frames, decode_state
from airgs_codec.decoder.group_states import load_states
from airgs_codec.encoder.publish import encode
from airgs_codec.encoder.settings import EncodeSettings, LevelSettings
from airgs_codec.media.h264 import state_codec
from airgs_codec.media.metrics import mse
from airgs_codec.package.manifest import pooled_quality
from airgs_codec.package.store import Package
from airgs_codec.play.catalogue import Catalogue
from airgs_codec.play.link import Link
from airgs_codec.play.policies.named import NAMES
from airgs_codec.play.regret import session_bound
from airgs_codec.play.session import simulate
from airgs_codec.play.settings import SessionSettings
from airgs_codec.play.trace import markov_trace
from airgs_codec.render import Camera, read_cameras, render
from airgs_codec.render.cpu import activate
from airgs_codec.render.differentiable import rasterize
from airgs_codec.render.inputs import RasterInputs
from airgs_codec.render.reference import render_reference
from airgs_codec.scene.ply import read_ply
from airgs_codec.scene.sequence import open_sequence
from airgs_codec.train.data.multiview import with_held_out
from airgs_codec.train.data.readers import open_scene
from airgs_codec.train.loss.photometric import photometric, windowed_ssim
from airgs_codec.train.loss.target import Target
from airgs_codec.train.run import train
from airgs_codec.train.settings import Temporal, TrainSettings

DATA = Path(__file__).parent.parent / "tests" / "data"
KEYFRAME = 3  # of the embedded views: the cake appears
SCENE, VIEWS = DATA / "fox", DATA / "fox_views"


@dataclass(frozen=True, slots=True)
class Row:
    """One measurement; `error` in the unit named, `bytes` a frame where there are any."""

    section: str
    method: str  # a curve
    setting: str  # a point on it
    seconds: float
    error: float
    unit: str
    bytes: float = math.nan
    note: str = ""


def timed(work: Callable[[], object], repeats: int = 5) -> float:
    """Median seconds of a call, after one that compiles."""
    work()
    runs = []
    for _ in range(repeats):
        began = time.perf_counter()
        work()
        runs.append(time.perf_counter() - began)
    return float(np.median(runs))


def rmse_of(decibels: float) -> float:
    """Of samples in 0..1."""
    return 10 ** (-decibels / 20)


def measure_encode(folder: Path, quick: bool) -> Iterator[Row]:
    """Presets x quality factors."""
    sequence = open_sequence(SCENE)
    presets = ("ultrafast", "medium", "veryslow") if quick else ("ultrafast", "veryfast", "medium", "slow", "veryslow")
    for preset in presets:
        for factor in (0.5, 1.0, 2.0) if quick else (0.35, 0.5, 0.7, 1.0, 1.4, 2.0, 2.8):
            target = folder / f"{preset}-{factor}"
            settings = EncodeSettings(
                quality=factor,
                calibrate="none",
                levels=(LevelSettings(0.0),),
                key_factors=(1.0,),
                measure_pictures=8,
                preset=preset,
            )
            report = encode(sequence, target, settings)
            m = report.manifest
            quality = pooled_quality(m, 0, 0)
            assert quality is not None
            means = max(g.levels[0].max_error[0] for g in m.groups)
            size = m.bytes_of(m.rung_files(0, 0)) / m.frames
            note = f"{quality.psnr:.2f} dB, largest error of means {means:.2g} motion units"
            yield Row(
                "encode", preset, f"x{factor:g}", report.encode_s / m.frames, rmse_of(quality.psnr), "RMSE", size, note
            )


def measure_decode(package: Package) -> Iterator[Row]:
    """Stages of a frame of level 0, then whole frames of every level."""
    m = package.manifest
    frames = m.frames
    stages: dict[str, Callable[[], object]] = {
        "H.264 to codes": lambda: [
            list(decode_state(package, i, 0, 0, s.stop - s.start))
            for i, s in enumerate(m.segments)
            if m.state_files(i, 0)
        ],
        "canonical space": lambda: [decode_canonical(package, g, 0) for g in range(len(m.groups))],
        "all": lambda: list(decode_frames(package, 0, frames)),
    }
    for name, work in stages.items():
        yield Row("decode", "stages", name, timed(work) / frames, math.nan, "")
    for j, level in enumerate(m.levels):
        quality = pooled_quality(m, j, 0)
        assert quality is not None
        took = timed(lambda j=j: list(decode_frames(package, 0, frames, level=j))) / frames  # type: ignore[misc]
        size = sum(m.bytes_of(m.state_files(i, j)) for i in range(len(m.segments))) / frames
        yield Row("decode", "levels", level.id, took, rmse_of(quality.psnr), "RMSE", size, f"{quality.psnr:.2f} dB")


def measure_planes(package: Package) -> Iterator[Row]:
    """The states of the first group coded as they are, in random order, and with clipping in place of escapes."""
    m = package.manifest
    states = load_states(package, 0)
    values = states.values.astype(np.float64)
    camera = read_cameras(SCENE / "transforms.json")[0]
    truth = [render(states.show(v.astype(np.float32)), camera).rgb for v in states.values]
    shuffled = np.random.default_rng(0).permutation(values.shape[2])
    jumps = values.copy()
    jumps[1::2, 0, ::7] += 400 * states.steps[0]  # every seventh row leaves 8 bits every second frame
    units = states.steps / m.state_gain
    jumped = [render(states.show(v.astype(np.float32)), camera).rgb for v in jumps]
    for method, data, order, wanted in (
        ("Morton order, escapes", values, None, truth),
        ("random order", values[:, :, shuffled], shuffled, truth),
        ("clipped", clipped(values, units), None, truth),
        ("with jumps, escapes", jumps, None, jumped),
        ("with jumps, clipped", clipped(jumps, units), None, jumped),
    ):
        began = time.perf_counter()
        sizes, coded = encode_and_decode(data, states.steps, state_codec("medium"))
        seconds, decoded = time.perf_counter() - began, coded.astype(np.float32)
        if order is not None:
            restored = np.empty_like(decoded)
            restored[:, :, order] = decoded
            decoded = restored
        error = np.mean([mse(render(states.show(v), camera).rgb, w) for v, w in zip(decoded, wanted, strict=True)])
        yield Row("planes", method, "L0", seconds / len(data), math.sqrt(error), "RMSE", sum(sizes) / len(data))


def clipped(values: NDArray[np.float64], units: NDArray[np.float64]) -> NDArray[np.float64]:
    """(T, channels, n) within what 8 bits around each channel's median hold, `units` (channels,) a code."""
    middle, reach = np.median(values, axis=(0, 2))[:, None], (escapes.LIMIT - 1) * units[:, None]
    return np.clip(values, middle - reach, middle + reach)


def reference(inputs: RasterInputs[torch.Tensor], camera: Camera) -> torch.Tensor:
    """The picture by the definition, in the precision of the inputs."""
    return render_reference(inputs, camera)[0]


def measure_render(quick: bool) -> Iterator[Row]:
    """Pictures of the embedded scene of several sizes, against float64."""
    g = read_ply(SCENE / "000005.ply")
    whole = next(c for c in read_cameras(SCENE / "transforms.json") if c.held_out)
    a = activate(g)
    columns = RasterInputs(*(torch.from_numpy(getattr(a, n)) for n in RasterInputs._fields))
    for side in (16, 32, 48) if quick else (16, 32, 64, 96):
        scale = side / whole.width
        camera = Camera(
            "bench", side, side, whole.fx * scale, whole.fy * scale, whole.cx * scale, whole.cy * scale,
            whole.world_to_camera,
        )  # fmt: skip
        exact = RasterInputs(*(c.double() for c in columns))
        truth = reference(exact, camera)
        methods: dict[str, Callable[[Camera], torch.Tensor]] = {
            "tiles": lambda view: rasterize(columns, view)[0],
            "definition, float32": lambda view: reference(columns, view),
            "definition, float64": lambda view, c=exact: reference(c, view),  # type: ignore[misc]
        }
        for name, draw in methods.items():
            error = float((draw(camera).double() - truth).abs().mean())
            took = timed(lambda d=draw, v=camera: d(v), 3)  # type: ignore[misc]
            yield Row("render", name, f"{side}²", took, error, "mean |error|")


def measure_loss(quick: bool) -> Iterator[Row]:
    """Value of 1 - SSIM by the fused kernel and by float32 convolutions, against float64."""
    random = np.random.default_rng(0)
    for side in (64, 256) if quick else (64, 128, 256, 512):
        pictures = [torch.from_numpy(random.random((side, side, 3), np.float32)) for _ in range(2)]
        target = Target(pictures[1].numpy())
        truth = float(windowed_ssim(pictures[0].double(), pictures[1].double()))
        fused = photometric(pictures[0], target).ssim
        plain = float(windowed_ssim(*pictures))
        works: dict[str, tuple[float, Callable[[], object]]] = {
            "fused kernel with gradient": (fused, lambda p=pictures, t=target: photometric(p[0], t)),  # type: ignore[misc]
            "convolutions, float32": (plain, lambda p=pictures: windowed_ssim(*p)),  # type: ignore[misc]
        }
        for name, (value, work) in works.items():
            yield Row("loss", name, f"{side}²", timed(work), abs(value - truth), "|SSIM error|")


def measure_train(folder: Path, quick: bool) -> Iterator[Row]:
    """Held-out error of fits of several lengths on the embedded views."""
    scene = with_held_out(open_scene(VIEWS), None)
    base = TrainSettings(budget=4000, capacity=8000)
    lengths = (100, 300) if quick else (100, 200, 400, 800, 1600)
    frames = scene.frames

    def run(method: str, settings: TrainSettings, count: int, setting: str, at: int) -> Row:
        part = replace(scene, frames=frames[:count])
        target = folder / f"{method}-{setting}".replace(" ", "")
        model = train(part, target, settings)
        record = model.record.frames[at]
        quality = record.held_out_psnr
        assert quality is not None
        still = f", means static {100 * record.static['means']:.0f} %" if record.static else ""
        note = f"{quality:.2f} dB, {record.gaussians} Gaussians{still}"
        return Row("train", method, setting, record.seconds, rmse_of(quality), "RMSE", math.nan, note)

    for count in lengths:
        yield run("first frame", replace(base, first_iterations=count), 1, f"{count}", 0)
    # No frame starts a group.
    start = replace(base, first_iterations=lengths[-1], min_psnr_db=1.0, max_drop_db=math.inf)
    for deltas in ("direct", "mlp", "mlp+residual"):
        for count in (30, 100) if quick else (30, 100, 300):
            yield run(deltas, replace(start, deltas=deltas, frame_iterations=count), 2, f"{count}", 1)
    for weight in (0.0, 8e-4, 8e-3):
        settings = replace(start, frame_iterations=100, temporal=Temporal(weight=weight))
        yield run(f"temporal {weight:g}", settings, 2, "100", 1)
    for count in (50, 150) if quick else (50, 150, 500, 1500):
        both = replace(scene, frames=frames[KEYFRAME - 1 : KEYFRAME + 1])
        alone = replace(scene, frames=frames[KEYFRAME : KEYFRAME + 1], points=None)  # they are of the first frame
        for method, part, settings in (
            ("keyframe warm", both, replace(start, key_iterations=count, frame_iterations=5, min_psnr_db=99.0)),
            ("keyframe from scratch", alone, replace(start, first_iterations=count)),
        ):
            model = train(part, folder / f"{method}{count}".replace(" ", ""), settings)
            record = model.record.frames[-1]
            assert record.held_out_psnr is not None
            note = f"{record.held_out_psnr:.2f} dB, {record.gaussians} Gaussians"
            yield Row(
                "train", method, f"{count}", record.seconds, rmse_of(record.held_out_psnr), "RMSE", math.nan, note
            )


def measure_select(package: Package, quick: bool) -> Iterator[Row]:
    """Mean regret over seeded links, and seconds of a choice."""
    c = Catalogue.of(package)
    rate = 20 * package.manifest.bytes_of(package.manifest.rung_files(0, 0)) / c.duration_s  # 2.5 times its own
    for name in NAMES:
        regrets, took, choices = [], 0.0, 0
        for seed in range(4 if quick else 12):
            link = Link(markov_trace(seed, rate))
            rules = SessionSettings(loops=max(1, round(20 / c.duration_s)))
            began = time.perf_counter()
            log = simulate(c, link, name, rules)
            took += time.perf_counter() - began
            choices += len(log.fetches) - 1
            bound = session_bound(log)
            assert bound is not None
            regrets.append(bound - log.mean_quality)
        yield Row("select", name, "", took / choices, float(np.mean(regrets)), "dB of regret")


def measure_left_out(folder: Path) -> Iterator[Row]:
    """The default package with and without what the scene can do without."""
    sequence = open_sequence(SCENE)
    for name, keep in (("as the scene needs", False), ("--keep-all", True)):
        report = encode(sequence, folder / name, EncodeSettings(keep_all=keep, measure_pictures=8))
        m = report.manifest
        quality = pooled_quality(m, 0, 0)
        assert quality is not None
        size = m.bytes_of(m.rung_files(0, 0)) / m.frames
        note = f"{quality.psnr:.2f} dB"
        yield Row("left out", name, "", report.encode_s / m.frames, rmse_of(quality.psnr), "RMSE", size, note)
