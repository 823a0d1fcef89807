"""A GPU beside the CPU: do both draw the same, and what do fits and encodes take?

    python -m tools.check_gpu SCENE …

Scenes are folders of pictures, as airgs-train reads them. With the default settings of the device, in pictures of full
size, five frames of each are fitted: a first frame, two in its group, a keyframe and one in the group of that. What was
trained is drawn by the device and the CPU, and compared; then it is encoded. The same fits with a tenth of the
iterations follow on both, and those with all iterations on the CPU come last.

Parts are done in the order of their worth, each in a process of its own. At the limit, the one that is under way is
stopped, and those behind it are left out; the page is written after each. Ends with status 1 where a difference is over
its limit or a part fails, and with 2 where gsplat cannot run. `--device cpu` does all of it without a GPU.
"""

from __future__ import annotations

import importlib.metadata
import math
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, astuple, dataclass, replace
from functools import partial
from pathlib import Path
from statistics import mean, median

import numpy as np
import torch
from numpy.typing import NDArray

from airgs_codec.encoder.publish import encode
from airgs_codec.encoder.settings import EncodeSettings
from airgs_codec.errors import ConfigError
from airgs_codec.render import read_cameras
from airgs_codec.render.backend import CPU, Loaded, open_renderer
from airgs_codec.render.cpu import RasterInputs
from airgs_codec.render.cuda import OnCuda, rasterize, upload
from airgs_codec.scene.camera import Camera
from airgs_codec.scene.gaussians import SH_REST, Gaussians
from airgs_codec.scene.sequence import open_sequence
from airgs_codec.trainer import default_settings, train
from airgs_codec.trainer.data.multiview import MultiviewScene, with_held_out
from airgs_codec.trainer.data.readers import open_scene
from airgs_codec.trainer.record import read_model
from airgs_codec.trainer.settings import TrainSettings
from tools.lab import Lab, Page, Row, Section, Table, alone, required, seconds_of, setting
from tools.lab.command import run_alone
from tools.lab.experiments import Experiment

TOOL = Experiment(
    "gpu", "Does a GPU draw what the CPU does, and how fast does it fit?", "tools.check_gpu", "8 min, on a GPU"
)

FRAMES, KEYFRAME = 5, 3  # of a scene that are fitted, and the first of them in a second group
MIB = 1 << 20


@dataclass(frozen=True, slots=True)
class Difference:
    worst: float  # sample of the picture; pixels flip where alpha is next to 1/255
    mean: float
    gradients: float

    def good(self) -> bool:
        return all(value <= limit for value, limit in zip(astuple(self), astuple(LIMITS), strict=True))


LIMITS = Difference(worst=5e-3, mean=1e-5, gradients=1e-2)


def compare(a: Loaded, b: Loaded, camera: Camera) -> Difference:
    """The difference of two renderers with the same Gaussians, for a loss of random weights."""
    apart = np.abs(a.draw(camera).rgb - b.draw(camera).rgb)
    pull = np.random.default_rng(0).normal(size=apart.shape).astype(np.float32)
    by, by_other = (_gradients(side, camera, pull) for side in (a, b))
    gradients = float(np.max([_relative(x, y) for x, y in zip(by, by_other, strict=True)]))
    return Difference(float(apart.max()), float(apart.mean()), gradients)


def _gradients(side: Loaded, camera: Camera, pull: NDArray[np.float32]) -> list[NDArray[np.float32]]:
    tensors = side.tensors if isinstance(side, OnCuda) else map(torch.from_numpy, side.inputs)
    leaves = RasterInputs(*(t.detach().clone().requires_grad_() for t in tensors))
    rgb, _ = rasterize(leaves, [camera])
    return [g.cpu().numpy() for g in torch.autograd.grad((rgb[0] * upload(pull, rgb.device)).sum(), leaves)]


def _relative(a: NDArray[np.generic], b: NDArray[np.generic]) -> float:
    norm, apart = (float(np.linalg.norm(part)) for part in (a, np.subtract(a, b, dtype=np.float64)))
    return apart / norm if norm else apart


def measured(function: Callable[..., list[Row]], device: str, *arguments: object) -> tuple[list[Row], float | None]:
    """The rows that a part gives on a device, and the most MiB of the GPU that torch had; None: it is the CPU."""
    open_renderer(device)
    rows = function(device, *arguments)
    if device == "cpu":
        return rows, None
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
        counts = (base.iterations_from_scratch(views), base.keyframe_iterations, base.frame_iterations)
        first, key, frame = (max(1, round(self.effort * count)) for count in counts)
        base = replace(base, first_iterations=first, keyframe_iterations=key, frame_iterations=frame)
        return replace(base, group_frames=KEYFRAME, min_psnr_db=0.0, max_drop_db=math.inf)

    def open(self) -> MultiviewScene:
        """The frames that are fitted. Raises SceneError."""
        count = min(FRAMES, len(open_scene(self.scene)))
        return with_held_out(open_scene(self.scene, frames=(0, count)), None)


def fit(device: str, asked: Fit, folder: Path) -> list[Row]:
    """Fit the frames into a model folder, in pictures of full size, and give a row of what came out."""
    scene = asked.open()
    train(scene, folder, asked.settings(sum(not camera.held_out for camera in scene.cameras)), device=device)
    record = read_model(folder).record
    frames, s = record.frames, record.settings
    held_out = [f.held_out_psnr for f in frames if f.held_out_psnr is not None]
    size = max((camera.width, camera.height) for camera in read_cameras(folder))
    counts = (s["first_iterations"], s["keyframe_iterations"], s["frame_iterations"])
    row: Row = {"scene": asked.scene.name, "device": device, "pictures": f"{size[0]} x {size[1]}"}
    row["iterations"] = ", ".join(map(str, counts))
    for name, kind in (("first frame, s", "first"), ("keyframe, s", "keyframe"), ("frame in a group, s", "frame")):
        row[name] = median([frame.seconds for frame in frames if frame.kind == kind] or [math.nan])
    quality = {"PSNR, dB": mean(f.psnr for f in frames), "held-out, dB": mean(held_out) if held_out else None}
    return [row | quality | {"frames": len(frames), "Gaussians": frames[-1].gaussians}]


def encoded(device: str, name: str, model: Path, settings: EncodeSettings) -> list[Row]:
    sequence = open_sequence(model)
    with tempfile.TemporaryDirectory(dir=model.parent) as folder:
        took, report = seconds_of(lambda: encode(sequence, f"{folder}/package", replace(settings, device=device)))
    m = report.manifest
    top, all_rungs = m.bytes_of(m.rung_files(0, 0)) / m.frames, m.media_bytes() / m.frames
    deciding = sum(choice.seconds for choice in report.plan.choices)
    times = {"deciding, s": deciding, "encoding, s": report.encode_s, "measuring, s": report.measure_s}
    row: Row = {"scene": name, "device": device, "frames": m.frames, "seconds": took.wall, **times}
    return [row | {"bytes a frame": round(top), "with all rungs": round(all_rungs)}]


TENTH = 0.1  # of the iterations, of fits that are short enough for both
DONE = "done"


@dataclass(frozen=True, slots=True)
class Options:
    scenes: tuple[Path, ...] = required("folders of pictures, as airgs-train reads them")
    sequence: Path = setting(Path("tests/data/fox"), "Gaussians that are drawn before anything is trained")
    device: str = setting("cuda", "what stands beside the CPU", choices=("cuda", "cpu"))
    limit: float = setting(8.0, "minutes for all parts")
    effort: float = setting(1.0, "times the iterations of the default settings; less for a trial")
    cameras: int = setting(2, "of a scene, in which pictures are compared")

    def __post_init__(self) -> None:
        if self.limit <= 0 or self.effort <= 0:
            raise ConfigError(f"expected a --limit and an --effort above 0, got {self.limit:g} and {self.effort:g}")


Part = tuple[str, str, str, str, Callable[..., list[Row]], tuple[object, ...]]  # what, table, scene, device, work


def run(options: Options, lab: Lab) -> Page:
    open_renderer(options.device)  # compiles gsplat's kernels where they are not there, which is not of the time
    begun, parts = time.perf_counter(), []
    rows: dict[str, list[Row]] = {"fits": [], "encodes": [], "pictures": []}
    with tempfile.TemporaryDirectory() as folder:
        for what, table, scene, device, function, arguments in parts_of(options, Path(folder)):
            lab.tell(f"{what}: {scene} on {device}")
            left_s = begun + 60 * options.limit - time.perf_counter()
            row: Row = {"part": what, "scene": scene, "device": device}
            try:
                how, (found, gpu_mib) = alone(measured, function, device, *arguments, limit_s=max(0.0, left_s))
            except TimeoutError:
                row["state"] = "no time left"
            except Exception as error:  # whatever it is, others may still be done
                row["state"] = f"failed: {(str(error).strip().splitlines() or [type(error).__name__])[0]}"
            else:
                rows[table] += found
                row |= {"state": DONE, "seconds": how.took.wall, "memory, MB": how.peak_mb, "of the GPU, MiB": gpu_mib}
            parts.append(row)
            lab.keep(page := page_of(rows, parts, options))
    return page


def parts_of(options: Options, folder: Path) -> Iterator[Part]:
    """All parts, those of most worth first; models go to the folder."""
    device = options.device
    models = {scene: folder / f"{i}" for i, scene in enumerate(options.scenes)}

    def fitting(scene: Path, device: str, model: Path, share: float = 1.0) -> Part:
        what, asked = "fit" if share == 1 else "a tenth of a fit", Fit(scene, options.device, share * options.effort)
        return what, "fits", scene.name, device, fit, (asked, model)

    def comparing(name: str, model: Path) -> Part:
        return "compare", "pictures", name, device, pictures, (name, model, options.cameras)

    def encoding(name: str, device: str, model: Path) -> Part:
        return "encode", "encodes", name, device, encoded, (name, model, EncodeSettings())

    yield comparing(options.sequence.name, options.sequence)
    for scene, model in models.items():
        yield fitting(scene, device, model)
    for scene, model in models.items():
        yield comparing(scene.name, model)
        yield encoding(scene.name, device, model)
    for scene, model in models.items():
        yield fitting(scene, device, folder / f"{model.name}-tenth", TENTH)
        yield fitting(scene, "cpu", folder / f"{model.name}-cpu-tenth", TENTH)
        yield encoding(scene.name, "cpu", model)
    for scene, model in models.items():
        yield fitting(scene, "cpu", folder / f"{model.name}-cpu")


def page_of(rows: dict[str, list[Row]], parts: Sequence[Row], options: Options) -> Page:
    seen = rows["pictures"]
    apart = [Difference(**{name: row[name] for name in asdict(LIMITS)}) for row in seen]
    over, failed = sum(not one.good() for one in apart), sum("failed" in row["state"] for row in parts)
    done = sum(row["state"] == DONE for row in parts)
    answer = f"{done} of {len(parts)} parts were done, {failed} failed; "
    answer += f"{over} of {len(seen)} pictures are over a limit." if over else f"{len(seen)} pictures agree."
    largest = {name: float(np.max([row[name] for row in seen])) for name in asdict(LIMITS)} if seen else {}
    limits = [{"scene": "largest", **largest}, {"scene": "limit", **asdict(LIMITS)}]
    tables = [Table(name, rows[name]) for name in ("fits", "encodes")]
    tables += [Table("pictures", [*seen, *limits]), Table("parts", parts)]
    how = (
        f"{gpu_of(options.device)}. PSNR is the mean over views and frames; seconds of frames in a group are their "
        "median. In `pictures` are the largest and the mean difference of samples, and the "
        "largest relative difference (L2) of the gradients by any attribute."
    )
    if options.effort != 1:
        how += f" A trial with {options.effort:g} times the iterations."
    return Page([Section(answer, tables=tables)], how, failed=bool(over or failed))


def gpu_of(device: str) -> str:
    if device != "cuda":
        return f"No GPU, torch {torch.__version__}"
    gpu, gsplat = torch.cuda.get_device_properties(0), importlib.metadata.version("gsplat")
    memory = f"{gpu.total_memory / 2**30:.0f} GiB"
    return f"{gpu.name}, {memory}, CUDA {torch.version.cuda}, torch {torch.__version__}, gsplat {gsplat}"


main = partial(run_alone, TOOL)

if __name__ == "__main__":
    sys.exit(main())
