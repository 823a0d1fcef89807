"""Error against run time, of everything that trades one for the other, on the embedded scene.

    python -m tools.work_precision -o OUT [--quick]

Writes OUT/work_precision.csv (a row a measurement), .json (the same with machine, versions and command), codec.png and
parts.png (log error over log seconds, a curve a method). --quick takes two minutes on two cores, the whole about ten.

encode: x264 presets x quality factors. decode: stages, levels. planes: ordering and escapes on and off. render: tile
rasteriser and plain float32 against the float64 definition. loss: the fused kernel against float64.
train: the first frame, the next by direct, MLP and hybrid deltas, temporal weights, a keyframe warm and from scratch.
select: regret of policies. left out: with and without. scale: synthetic scenes, seconds and memory over N.
"""

from __future__ import annotations

import argparse
import csv
import json
import math
import os
import platform
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict
from pathlib import Path

os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

import numba
import numpy as np
import torch

from airgs_codec._report import new_figure, plain_log_ticks, save_figure
from airgs_codec.encoder.publish import encode
from airgs_codec.encoder.settings import EncodeSettings
from airgs_codec.media.h264 import library_versions
from airgs_codec.package.store import open_package
from airgs_codec.scene.sequence import open_sequence
from tools.bench_scale import COUNTS, FRAMES, measure_scale
from tools.precision import (
    SCENE,
    Row,
    measure_decode,
    measure_encode,
    measure_left_out,
    measure_loss,
    measure_planes,
    measure_render,
    measure_select,
    measure_train,
)

PICTURES = {"codec.png": ("encode", "decode", "scale"), "parts.png": ("render", "train", "select")}


def plot(rows: list[Row], path: Path, sections: tuple[str, ...]) -> None:
    """Log error over log seconds, a panel a section and a curve a method."""
    figure = new_figure(5 * len(sections), 4.4)
    for axis, section in zip(figure.subplots(1, len(sections)), sections, strict=True):
        scale = section == "scale"
        some = [r for r in rows if r.section == section and (scale or r.error > 0)]
        for method in dict.fromkeys(r.method for r in some):
            points = [r for r in some if r.method == method]
            x = [float(r.setting) if scale else r.seconds for r in points]
            y = [r.seconds if scale else r.error for r in points]
            axis.plot(x, y, "o-", label=method, markersize=4)
        axis.set_xscale("log")
        axis.set_yscale("log")
        for side in (axis.xaxis, axis.yaxis):
            plain_log_ticks(side)
        words = ("Gaussians", "seconds a frame") if scale else ("seconds", some[0].unit if some else "")
        axis.set(xlabel=words[0], ylabel=words[1], title=section)
        axis.grid(alpha=0.3, which="both")
        axis.legend(fontsize=7)
    save_figure(figure, path)


def main() -> None:
    """Measure, print, write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, default=Path("build/work_precision"))
    parser.add_argument("--quick", action="store_true")
    args = parser.parse_args()
    torch.set_num_threads(1)
    args.output.mkdir(parents=True, exist_ok=True)
    rows: list[Row] = []
    began = time.perf_counter()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        encode(open_sequence(SCENE), folder / "fox", EncodeSettings(measure_pictures=8))
        package = open_package(folder / "fox")
        parts: list[Callable[[], Iterator[Row]]] = [
            lambda: measure_encode(folder, args.quick),
            lambda: measure_decode(package),
            lambda: measure_planes(package),
            lambda: measure_render(args.quick),
            lambda: measure_loss(args.quick),
            lambda: measure_train(folder, args.quick),
            lambda: measure_select(package, args.quick),
            lambda: measure_left_out(folder),
            lambda: (
                Row("scale", step, str(count), seconds / FRAMES, math.nan, "", size / FRAMES, note)
                for count, step, seconds, size, note in measure_scale((1000, 10_000) if args.quick else COUNTS)
            ),
        ]
        for part in parts:
            for row in part():
                rows.append(row)
                size = "" if math.isnan(row.bytes) else f"{row.bytes:10.0f} B"
                error = "" if math.isnan(row.error) else f"{row.error:.3g} {row.unit}"
                words = f"{row.section:<9}{row.method:<28}{row.setting:<16}{1e3 * row.seconds:11.3f} ms"
                print(f"{words}  {error:<24}{size:>12}  {row.note}", flush=True)
    with (args.output / "work_precision.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, list(asdict(rows[0])))
        writer.writeheader()
        writer.writerows(asdict(row) for row in rows)
    versions = library_versions() | {"numpy": np.__version__, "numba": numba.__version__, "torch": torch.__version__}
    machine = {"processor": platform.machine(), "cores": os.cpu_count(), "python": platform.python_version()}
    record = {
        "command": " ".join(sys.argv),
        "seconds": time.perf_counter() - began,
        "machine": machine,
        "versions": versions,
    }
    plain = [{k: None if isinstance(v, float) and math.isnan(v) else v for k, v in asdict(r).items()} for r in rows]
    text = json.dumps(record | {"rows": plain}, indent=1, allow_nan=False)
    (args.output / "work_precision.json").write_text(text + "\n")
    for name, sections in PICTURES.items():
        plot(rows, args.output / name, sections)
    print(f"{time.perf_counter() - began:.0f} s, {args.output}")


if __name__ == "__main__":
    main()
