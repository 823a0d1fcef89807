"""Error of the CPU renderer against its float64 definition, over seconds a picture.

The definition is far too slow for whole pictures: errors are those of crops at full size, and its seconds are those of
the crops times the ratio of pixels.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import numpy as np
import torch
from numpy.typing import NDArray

from airgs_codec.render import Camera, cpu
from airgs_codec.render.cpu import RasterInputs
from airgs_codec.render.reference import render_reference
from airgs_codec.scene.camera import resized
from tools.lab import seconds_of, timed
from tools.lab.numerics.rows import Bench, Place, Point, Row, Scene

SIZES = (0.25, 0.5, 1.0)  # of the sides of a picture
PAIRS = 1e7  # most pairs of a pixel and a Gaussian in a crop of the definition
CROPS = ((0.3, 0.5), (0.5, 0.5), (0.7, 0.5), (0.5, 0.7))  # their middles
DEFINITION, SHIPPED = "definition", "tiles, float32"
UNIT = "grey levels of 255, mean error"
Columns = RasterInputs[NDArray[np.float32]]
Picture = NDArray[np.float64]


def measure(bench: Bench) -> Iterator[Point]:
    for scene in bench.scenes:
        for size in SIZES[-1:] if bench.quick else SIZES:
            reads = {"size": size, "repeats": bench.repeats}
            yield Point("renderer precision", scene, reads, partial(precision, scene, size, bench.repeats))


def view_of(scene: Scene) -> Camera:
    cameras = scene.sequence.cameras
    return next((c for c in cameras if c.held_out), cameras[0])


def columns_of(scene: Scene) -> Columns:
    return cpu.activate(scene.sequence.load([len(scene.sequence) // 2]).frames[0])


def crops(camera: Camera, rows: int) -> list[Camera]:
    """Parts of what a camera sees, at its scale, small enough for the definition of so many Gaussians."""
    side = max(8, min(int(math.sqrt(PAIRS / rows)), camera.width // 2, camera.height // 2))
    places = [(int(x * camera.width) - side // 2, int(y * camera.height) - side // 2) for x, y in CROPS]
    return [replace(camera, width=side, height=side, cx=camera.cx - x, cy=camera.cy - y) for x, y in places]


def define(columns: Columns, camera: Camera, precision: torch.dtype) -> Picture:
    inputs = RasterInputs(*(torch.from_numpy(column).to(precision) for column in columns))
    return render_reference(inputs, camera)[0].double().numpy()


def draw(columns: Columns, camera: Camera) -> Picture:
    return cpu.blend(columns, camera, camera.background).picture.rgb.astype(np.float64)


def grey_levels(pictures: list[Picture], truth: list[Picture]) -> float:
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
    rows = [Row.of(Place("renderer", scene.name, SHIPPED, words), seconds, [error], UNIT)]
    for name, took, drawn in (("float32", single_took, single), ("float64", exact_took, truth)):
        place = Place("renderer", scene.name, f"{DEFINITION}, {name}", words)
        rows.append(Row.of(place, [took.times(pixels)], [grey_levels(drawn, truth)], UNIT))
    return rows
