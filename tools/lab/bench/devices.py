"""A GPU beside the CPU: do both draw the same, and what do fits and encodes take?

Scenes are folders of pictures, as airgs-train reads them. With the default settings of the device, in pictures of full
size, five frames of each are fitted: a first frame, two in its group, a keyframe and one in the group of that. What was
trained is drawn by the device and the CPU, and compared; then it is encoded. The same fits with a tenth of the
iterations follow on both; on the CPU all iterations are done where ten times what the tenth took is left.

Parts are done in the order of their worth, each in a process of its own. At the limit, the one that is under way is
stopped, and those behind it are left out; the page is written after each. Ends with status 1 where a difference is over
its limit or a part fails, and with 2 where gsplat cannot run. `--device cpu` does all of it without a GPU.
"""

from __future__ import annotations

import importlib.metadata
import math
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path

import numpy as np

from airgs_codec.encoder.settings import EncodeSettings
from airgs_codec.errors import ConfigError
from airgs_codec.render.backend import open_renderer
from tools.lab import Lab, Page, Row, Section, Table, alone, required, setting
from tools.lab.bench.device_parts import LIMITS, Difference, Fit, encoded, fit, fitted, measured, pictures

TENTH = 0.1  # of the iterations, of fits that are short enough for both
DONE, STOPPED = "done", "stopped at the limit"
LEFT_OUT, NOT_KNOWN = "left out: no time left", "left out: nothing tells how long it takes"


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


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """A function of `device_parts`, and the table that its rows go to."""

    what: str  # for people
    table: str
    scene: str
    device: str
    function: Callable[..., list[Row]]
    arguments: tuple[object, ...]
    left: Callable[[], list[Row]] = list  # the rows that there are where it is stopped
    tenth: Part | None = None  # this one takes ten times as long, and is left out where that is not there


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    parts: list[Row] = field(default_factory=list)  # a row for each part
    rows: dict[str, list[Row]] = field(default_factory=lambda: {"fits": [], "encodes": [], "pictures": []})
    took: dict[Part, float] = field(default_factory=dict)  # seconds of those that are done

    def do(self, part: Part, left_s: float) -> None:
        needed = 0.0 if part.tenth is None else self.took.get(part.tenth, math.inf) / TENTH
        row: Row = {"part": part.what, "scene": part.scene, "device": part.device}
        if left_s <= needed:
            self.parts.append(row | {"state": NOT_KNOWN if left_s > 0 and needed == math.inf else LEFT_OUT})
            return
        begun = time.perf_counter()
        rows: list[Row] = []
        try:
            how, (rows, gpu_mib) = alone(measured, part.function, part.device, *part.arguments, limit_s=left_s)
            row |= {"state": DONE, "memory, MB": how.peak_mb, "of the GPU, MiB": gpu_mib}
            self.took[part] = how.took.wall
        except TimeoutError:
            row["state"], rows = STOPPED, part.left()
        except Exception as error:  # whatever it is, others may still be done
            said = str(error).strip().splitlines() or [type(error).__name__]
            row["state"], rows = f"failed: {said[0]}", part.left()
        self.parts.append(row | {"seconds": time.perf_counter() - begun})
        self.rows[part.table] += rows


def run(options: Options, lab: Lab) -> Page:
    open_renderer(options.device)  # compiles gsplat's kernels where they are not there, which is not of the time
    begun, found, machine = time.perf_counter(), Found(), facts(options.device)
    with tempfile.TemporaryDirectory() as folder:
        for part in parts_of(options, Path(folder)):
            lab.tell(f"{part.what}: {part.scene} on {part.device}")
            found.do(part, begun + 60 * options.limit - time.perf_counter())
            page = page_of(found, machine, options)
            lab.keep(page)
    return page


def parts_of(options: Options, folder: Path) -> Iterator[Part]:
    """All parts, those of most worth first; models go to the folder."""
    device, names = options.device, [scene.name for scene in options.scenes]
    models = [folder / f"{i}" for i in range(len(names))]
    yield _compare(options, options.sequence.name, options.sequence)
    for scene, model in zip(options.scenes, models, strict=True):
        yield _fit(options, scene, device, model)
    for name, model in zip(names, models, strict=True):
        yield _compare(options, name, model)
        yield _encode(device, name, model)
    whole = []
    for scene, model in zip(options.scenes, models, strict=True):
        yield _fit(options, scene, device, folder / f"{model.name}-tenth", TENTH)
        tenth = _fit(options, scene, "cpu", folder / f"{model.name}-cpu-tenth", TENTH)
        yield tenth
        yield _encode("cpu", scene.name, model)
        whole.append(replace(_fit(options, scene, "cpu", folder / f"{model.name}-cpu"), tenth=tenth))
    yield from whole


def _compare(options: Options, name: str, folder: Path) -> Part:
    arguments = name, folder, options.cameras
    return Part("compare", "pictures", name, options.device, pictures, arguments)


def _encode(device: str, name: str, model: Path) -> Part:
    return Part("encode", "encodes", name, device, encoded, (name, model, EncodeSettings()))


def _fit(options: Options, scene: Path, device: str, folder: Path, share: float = 1.0) -> Part:
    asked = Fit(scene, options.device, share * options.effort)
    what = "fit" if share == 1 else "a tenth of a fit"
    return Part(what, "fits", scene.name, device, fit, (asked, folder), partial(fitted, device, asked, folder))


def facts(device: str) -> list[Row]:
    import torch

    cuda = device == "cuda"
    gpu = torch.cuda.get_device_properties(0) if cuda else None
    values = {
        "GPU": f"{gpu.name}, {gpu.total_memory / 2**30:.0f} GiB" if gpu else None,
        "driver": _said("nvidia-smi", "--query-gpu=driver_version", "--format=csv,noheader") if cuda else None,
        "CUDA of torch": torch.version.cuda,
        "torch": torch.__version__,
        "gsplat": importlib.metadata.version("gsplat") if cuda else None,
        "commit": _said("git", "describe", "--always", "--dirty"),
    }
    return [{"machine": name, "is": value} for name, value in values.items()]


def _said(*command: str) -> str | None:
    """The first line that a program prints; None where it is not there or fails."""
    try:
        return subprocess.run(command, check=True, capture_output=True, text=True).stdout.splitlines()[0]
    except (OSError, subprocess.CalledProcessError, IndexError):
        return None


def page_of(found: Found, machine: Sequence[Row], options: Options) -> Page:
    seen = found.rows["pictures"]
    apart = [Difference(**{name: row[name] for name in asdict(LIMITS)}) for row in seen]
    over, failed = sum(not one.good() for one in apart), sum("failed" in row["state"] for row in found.parts)
    done = sum(row["state"] == DONE for row in found.parts)
    answer = f"{done} of {len(found.parts)} parts were done, {failed} failed; "
    answer += f"{over} of {len(seen)} pictures are over a limit." if over else f"{len(seen)} pictures agree."
    largest = {name: float(np.max([row[name] for row in seen])) for name in asdict(LIMITS)} if seen else {}
    limits = [{"scene": "largest", **largest}, {"scene": "limit", **asdict(LIMITS)}]
    tables = [Table("machine", machine), *(Table(name, found.rows[name]) for name in ("fits", "encodes"))]
    tables += [Table("pictures", [*seen, *limits]), Table("parts", found.parts)]
    how = (
        "PSNR is the mean over views and frames; seconds of frames in a group are their median. In `pictures` are the "
    )
    how += "largest and the mean difference of samples, and relative differences (L2): the largest of the gradients by "
    how += "any attribute, and those of sums, maxima and counts of blending weights."
    if options.effort != 1:
        how += f" A trial with {options.effort:g} times the iterations."
    return Page([Section(answer, tables=tables)], how, failed=bool(over or failed))
