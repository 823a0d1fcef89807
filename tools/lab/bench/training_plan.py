"""What training takes in memory and time: its parts measured here, and what they come to for a whole frame.

The middle frame of a sequence is grown to --rows Gaussians (each split into as many smaller ones, drawn from it), seen
by a camera at --size. One iteration is taken apart: drawing, its gradient, the loss, Adam. Nothing is fitted: a plan,
not a result. On the CPU times are those of all cores together, which do not depend on what else a machine does; frames
are said to take as long as two idle cores would. With --device cuda it is the time that passes, and the peak of memory
of the GPU.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch

from airgs_codec.render import cpu
from airgs_codec.render.backend import open_renderer
from airgs_codec.scene.camera import Camera
from airgs_codec.scene.gaussians import Gaussians
from airgs_codec.scene.sequence import open_sequence
from airgs_codec.trainer.data.pictures import PICTURE_BYTES, TARGET_BYTES, Stored, Target
from airgs_codec.trainer.fit.losses import moments, photometric
from airgs_codec.trainer.fit.parameters import Adam, Parameters, from_gaussians, render_views
from airgs_codec.trainer.fit.variables import PerGaussian, Rates
from airgs_codec.trainer.settings import TrainSettings
from tools.lab import Lab, Page, Row, Section, Table, required, seconds_of, setting

REPEATS = 3  # of each part, of which the fastest counts
# float32 values of a Gaussian's channel that a fit with a temporal loss holds at once: the base, D, its gradient, two
# moments, the step of the codec, its weight, what D may still change, the sum of base and D, activated, its gradient.
COPIES = 11
# Of a pixel that is drawn: the picture, two gradients by it, those of the transmittance, and the scratch of SSIM.
PIXEL_BYTES = 3 * 12 + 2 * 4 + 72
PAIR_BYTES = 12 * 4 + 4 + 4 + 8  # of a (Gaussian, tile) pair on the CPU: gradients, its Gaussian, its place, its key
TWO_CORES = 1.8  # times as fast as one, measured on idle cores
MIB = 1 << 20


@dataclass(frozen=True, slots=True)
class Options:
    """What is trained."""

    sequence: Path = required("a sequence")
    views: Path = required("cameras, of which the first ones are taken")
    rows: int = setting(200_000, "Gaussians")
    cameras: int = setting(20, "cameras of the rig, whose pictures are kept")
    size: str = setting("1920x1080", "of pictures, pixels")
    device: str = setting("cpu", "cpu or cuda")
    iteration_views: int = setting(1, "pictures of an iteration")


def run(options: Options, lab: Lab) -> Page:
    """Measure the parts, and add up."""
    device = open_renderer(options.device).device
    torch.set_num_threads(1)
    sequence = open_sequence(options.sequence, views=options.views)
    width, height = (int(part) for part in options.size.split("x"))
    seen = [sized(camera, width, height) for camera in sequence.cameras[: options.iteration_views]]
    parts = measure(grown(sequence.read(len(sequence) // 2), options.rows), seen, device)
    return page_of(parts, options)


@dataclass(frozen=True, slots=True)
class Parts:
    """What was measured of one iteration that sees so many `views`."""

    rows: int
    channels: int  # of a Gaussian
    pixels: int  # of a picture
    views: int
    pairs: int  # (Gaussian, tile) pairs of a picture
    draw_s: float  # of all views
    gradient_s: float  # of drawing and loss
    loss_s: float
    adam_s: float
    target_s: float  # of one picture, from 8 bits, with what SSIM needs
    peak_bytes: int | None  # on the GPU; None: measured on the CPU

    @property
    def iteration_s(self) -> float:
        """Of one iteration whose targets are at hand, on the GPU or two idle cores; Adam takes one."""
        drawn = self.draw_s + self.gradient_s + self.loss_s
        return (drawn if self.peak_bytes is not None else drawn / TWO_CORES) + self.adam_s


def grown(g: Gaussians, rows: int, seed: int = 0) -> Gaussians:
    """So many Gaussians of a frame: each becomes several smaller ones, drawn from it, that cover the same area."""
    rng = np.random.default_rng(seed)
    taken = np.arange(rows) % len(g)
    out = g.take(taken)
    shift = np.where(np.arange(rows)[:, None] < len(g), 0.0, np.exp(out.log_scales) * rng.normal(size=(rows, 3)))
    shrink = 0.5 * np.log(max(1.0, rows / len(g)))
    means = (out.means + shift).astype(np.float32)
    return replace(out, means=means, log_scales=(out.log_scales - shrink).astype(np.float32))


def sized(camera: Camera, width: int, height: int) -> Camera:
    """The camera with another picture, in which its scene is as high."""
    share = height / camera.height
    fx, fy = camera.fx * share, camera.fy * share
    return replace(camera, width=width, height=height, fx=fx, fy=fy, cx=width / 2, cy=height / 2)


def measure(g: Gaussians, cameras: Sequence[Camera], device: str) -> Parts:
    """The parts of an iteration in which `cameras`, of one size, see `g`."""
    base = from_gaussians(g, device)
    targets = [Target(cpu.render(g, camera).rgb.clip(0, 1)) for camera in cameras]
    stored = Stored((targets[0].rgb * 255).astype(np.uint8))
    made = min(seconds_of(lambda: moments(stored.target(None)))[0].cpu for _ in range(REPEATS))
    for target in targets:
        moments(target)
    if device == "cuda":
        torch.cuda.reset_peak_memory_stats()
    variables = PerGaussian(base, 5.0)
    best = [_iteration(variables.adam, base, cameras, targets) for _ in range(REPEATS)]
    draw, loss, gradient, adam = (min(times) for times in zip(*best, strict=True))
    view = cpu.project(cpu.activate(g), cameras[0])
    channels = sum(v[0].numel() for v in base.values())
    peak = torch.cuda.max_memory_allocated() if device == "cuda" else None
    size = cameras[0].width * cameras[0].height
    return Parts(
        len(g), channels, size, len(cameras), len(view.slots), draw, gradient, loss, adam, made, peak
    )  # fmt: skip


def _iteration(
    adam: Adam, base: Parameters, cameras: Sequence[Camera], targets: Sequence[Target]
) -> tuple[float, float, float, float]:
    """Seconds of drawing, loss, gradient and Adam, each until the device is done."""
    marks = [_now(adam)]
    degree = round((1 + base["sh_rest"].shape[1]) ** 0.5) - 1
    pictures = render_views({n: p + adam.parameters[n] for n, p in base.items()}, cameras, degree)
    marks.append(_now(adam))
    loss = torch.stack([photometric(rgb, t) for (rgb, _), t in zip(pictures, targets, strict=True)]).mean()
    marks.append(_now(adam))
    loss.backward()
    marks.append(_now(adam))
    adam.rates = Rates().at(0.5, 5.0)
    adam.step()
    marks.append(_now(adam))
    draw, loss_s, gradient, step = np.diff(marks).tolist()
    return draw, loss_s, gradient, step


def _now(adam: Adam) -> float:
    if not adam.parameters["means"].is_cuda:
        return time.process_time()
    torch.cuda.synchronize()
    return time.perf_counter()


def memory_table(parts: Parts, cameras: int) -> list[Row]:
    """Of the main memory that a fit on the CPU holds, but for the program itself."""
    pictures, rows = cameras * 3 * parts.pixels, 4 * COPIES * parts.channels * parts.rows
    most = f"{cameras} x 36 bytes a pixel, at most {TARGET_BYTES / MIB:,.0f} MiB"
    held = [
        ("pictures in 8 bits", f"{cameras} cameras x 3 bytes a pixel", min(PICTURE_BYTES, pictures) / MIB),
        ("targets with their moments", most, min(TARGET_BYTES, 12 * pictures) / MIB),
        ("Gaussians, gradients, Adam", f"{COPIES} x {parts.channels} float32 a row", rows / MIB),
        ("pairs of a picture", f"{parts.pairs:,} x {PAIR_BYTES} bytes", parts.pairs * PAIR_BYTES / MIB),
        ("a picture, its gradient, SSIM", f"{PIXEL_BYTES} bytes a pixel", PIXEL_BYTES * parts.pixels / MIB),
    ]
    held.append(("together", "", sum(size for _, _, size in held)))
    return [{"memory": what, "counted as": how, "MiB": size} for what, how, size in held]


def page_of(parts: Parts, options: Options) -> Page:
    """Everything that was measured and what it comes to."""
    ms = [("drawing", parts.draw_s), ("loss", parts.loss_s), ("gradient", parts.gradient_s), ("Adam", parts.adam_s)]
    ms += [("together, on two idle cores or the GPU", parts.iteration_s), ("a target from 8 bits", parts.target_s)]
    settings = TrainSettings()
    counts = {
        "a first frame": settings.iterations_from_scratch(options.cameras),
        "a keyframe": settings.key_iterations,
        "a frame in a group": settings.frame_iterations,
    }
    times = [{"frame": f, "iterations": n, "minutes": n * parts.iteration_s / 60} for f, n in counts.items()]
    unit = "ms of all cores together" if parts.peak_bytes is None else "ms"
    tables = [
        Table(
            "training-parts",
            [{"part of an iteration": name, unit: 1e3 * s} for name, s in ms],
        ),
        Table("training-frames", times),
    ]
    if parts.peak_bytes is None:
        tables.append(Table("training-memory", memory_table(parts, options.cameras)))
        memory = f"memory holds {tables[-1].rows[-1]['MiB']:,.0f} MiB"
    else:
        memory = f"the peak of GPU memory in an iteration is {parts.peak_bytes / MIB:.0f} MiB"
    how = f"{parts.rows:,} Gaussians of {parts.channels} channels, {parts.views} pictures of {options.size} an "
    how += f"iteration, {parts.pairs:,} pairs in one."
    answer = f"A first frame takes {times[0]['minutes']:.1f} minutes, and {memory}."
    return Page([Section(answer, tables=tables)], how)
