"""Error of the CPU renderer against its float64 definition, over seconds a picture.

The definition is far too slow for whole pictures: errors are those of crops at full size, and its seconds are those of
the crops times the ratio of pixels. The renderer's tile size and its cut-off are constants; to see what others would
do, its kernels are compiled again from their source with other numbers.
"""

from __future__ import annotations

import importlib.util
import math
import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import ModuleType
from unittest.mock import patch

import numpy as np
import torch
from numpy.typing import NDArray

from airgs_codec.errors import ConfigError
from airgs_codec.render import Camera, cpu, cpu_kernels
from airgs_codec.render.cpu import RasterInputs
from airgs_codec.render.reference import render_reference
from airgs_codec.scene.camera import resized
from tools.lab.numerics.rows import Bench, Place, Point, Row, Scene
from tools.lab.timing import seconds_of, timed

SIZES = (0.25, 0.5, 1.0)  # of the sides of a picture
PAIRS = 1e7  # most pairs of a pixel and a Gaussian in a crop of the definition
CROPS = ((0.3, 0.5), (0.5, 0.5), (0.7, 0.5), (0.5, 0.7))  # their middles
TILES, CUTS = (8, 16, 32), (32, 64, 255, 510)
TILE, CUT = cpu_kernels.TILE, 255  # what the renderer has
DEFINITION, SHIPPED = "definition", "tiles, float32"
UNIT = "grey levels of 255, mean error"
Columns = RasterInputs[NDArray[np.float32]]
Picture = NDArray[np.float64]


def measure(bench: Bench) -> Iterator[Point]:
    """Float32 against float64, then other tiles, then other cut-offs."""
    repeats = 3 if bench.quick else 9
    for scene in bench.scenes:
        for size in SIZES[-1:] if bench.quick else SIZES:
            reads = {"size": size, "repeats": repeats}
            yield Point("renderer precision", scene, reads, partial(precision, scene, size, repeats))
        for panel, numbers in (
            ("tiles", TILES[:2] if bench.quick else TILES),
            ("cuts", CUTS[1:3] if bench.quick else CUTS),
        ):
            for number in numbers:
                kernels = partial(variant, bench.folder / "kernels", panel, number)
                make = partial(other, scene, (panel, number), kernels, repeats)
                yield Point(f"renderer {panel}", scene, {"number": number, "repeats": repeats}, make)


def view_of(scene: Scene) -> Camera:
    """A camera that nothing was trained on, else the first."""
    cameras = scene.sequence.cameras
    return next((c for c in cameras if c.held_out), cameras[0])


def columns_of(scene: Scene) -> Columns:
    """The frame in the middle, activated."""
    return cpu.activate(scene.sequence.load([len(scene.sequence) // 2]).frames[0])


def crops(camera: Camera, rows: int) -> list[Camera]:
    """Parts of what a camera sees, at its scale, small enough for the definition of so many Gaussians."""
    side = max(8, min(int(math.sqrt(PAIRS / rows)), camera.width // 2, camera.height // 2))
    places = [(int(x * camera.width) - side // 2, int(y * camera.height) - side // 2) for x, y in CROPS]
    return [replace(camera, width=side, height=side, cx=camera.cx - x, cy=camera.cy - y) for x, y in places]


def define(columns: Columns, camera: Camera, precision: torch.dtype) -> Picture:
    """A picture by the definition in a precision."""
    inputs = RasterInputs(*(torch.from_numpy(column).to(precision) for column in columns))
    return render_reference(inputs, camera)[0].double().numpy()


def draw(columns: Columns, camera: Camera) -> Picture:
    """A picture by the kernels."""
    return cpu.blend(columns, camera, camera.background).picture.rgb.astype(np.float64)


def grey_levels(pictures: list[Picture], truth: list[Picture]) -> float:
    """Mean absolute difference, of 255."""
    return 255 * float(np.mean([np.abs(a - b).mean() for a, b in zip(pictures, truth, strict=True)]))


def precision(scene: Scene, size: float, repeats: int) -> list[Row]:
    """The renderer and the definition in both precisions, for pictures of a size."""
    columns, camera = columns_of(scene), resized(view_of(scene), size)
    parts = crops(camera, len(columns.means))
    pixels = camera.width * camera.height / (len(parts) * parts[0].width * parts[0].height)
    exact_took, truth = seconds_of(lambda: [define(columns, part, torch.float64) for part in parts])
    single_took, single = seconds_of(lambda: [define(columns, part, torch.float32) for part in parts])
    words = f"{camera.width} x {camera.height}"
    seconds = timed(lambda: draw(columns, camera), repeats)
    error = grey_levels([draw(columns, part) for part in parts], truth)
    rows = [Row.of(Place("renderer", "precision", scene.name, SHIPPED, words), seconds, [error], UNIT)]
    for name, took, drawn in (("float32", single_took, single), ("float64", exact_took, truth)):
        place = Place("renderer", "precision", scene.name, f"{DEFINITION}, {name}", words)
        rows.append(Row.of(place, [took.times(pixels)], [grey_levels(drawn, truth)], UNIT))
    return rows


def other(scene: Scene, number: tuple[str, int], kernels: Callable[[], ModuleType], repeats: int) -> list[Row]:
    """The renderer with another constant."""
    columns, camera = columns_of(scene), view_of(scene)
    parts = crops(camera, len(columns.means))
    truth = [define(columns, part, torch.float64) for part in parts]
    panel, value = number
    with patch.object(cpu, "kernels", kernels()):
        seconds = timed(lambda: draw(columns, camera), repeats)
        error = grey_levels([draw(columns, part) for part in parts], truth)
    setting = f"1/{value}" if panel == "cuts" else str(value)
    return [Row.of(Place("renderer", panel, scene.name, scene.name, setting), seconds, [error], UNIT)]


def variant(folder: Path, panel: str, number: int) -> ModuleType:
    """The kernels with another tile size (tiles) or with a cut-off at alpha = 1 / number (cuts).

    They lie in `folder`, with numba's cache. Raises ConfigError where the source has no such constant any more.
    """
    if number == {"tiles": TILE, "cuts": CUT}[panel]:
        return cpu_kernels
    tile = {f"TILE = {TILE}\n": f"TILE = {number}\n"}
    # exp on [0, ln number] is a polynomial on a domain a little wider
    cut = {f"{CUT}": f"{number}", "domain=[0, 5.6]": f"domain=[0, {math.log(number) + 0.06:.3f}]"}
    source = replaced(Path(cpu_kernels.__file__).read_text(encoding="utf-8"), tile if panel == "tiles" else cut)
    folder.mkdir(exist_ok=True)
    path = folder / f"kernels_{panel}_{number}.py"
    if not path.is_file() or path.read_text(encoding="utf-8") != source:
        path.write_text(source, encoding="utf-8")
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec and spec.loader
    module = importlib.util.module_from_spec(spec)
    sys.modules[path.stem] = module  # where numba looks for what it has cached
    spec.loader.exec_module(module)
    return module


def replaced(source: str, words: Mapping[str, str]) -> str:
    """A source with other words. Raises ConfigError for one that is not there."""
    for old, new in words.items():
        if old not in source:
            raise ConfigError(f"{cpu_kernels.__name__}: expected {old.strip()!r} in its source")
        source = source.replace(old, new)
    return source
