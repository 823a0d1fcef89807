"""Rate and distortion of airgs beside the published layouts, in one run over the same rows, views and frames.

    python -m tools.bench_rd SEQUENCE --views transforms.json -o OUT [--fps 24] [--splat-transform COMMAND]

Writes OUT/rd.csv, OUT/rd.json (figures, BD-rates, machine, versions) and OUT/rd.png, and prints the table. PSNR is
render-referenced: pooled over the test cameras and `--frames` frames of the sequence; where transforms.json names
pictures of these cameras and frames, PSNR against them stands beside it. BD-rate (Bjontegaard 2001, with monotone cubic
interpolation of log rate over PSNR) spans only the PSNR that both curves cover; negative is smaller. The layouts are
given all rows in Morton order; "airgs, keeps all" is given no other.
"""

from __future__ import annotations

import argparse
import csv
import itertools
import json
import platform
import shlex
import subprocess
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from fractions import Fraction
from pathlib import Path

import cv2
import numpy as np
from scipy.interpolate import PchipInterpolator

from airgs_codec._report import new_figure, save_figure
from airgs_codec._sampling import evenly_spaced
from airgs_codec.analysis.grouping import plan_groups
from airgs_codec.coding.morton import morton_encode
from airgs_codec.decoder.decode import decode_frames
from airgs_codec.encoder.publish import encode
from airgs_codec.encoder.rate_target import PSNR, Goal
from airgs_codec.encoder.settings import EncodeSettings
from airgs_codec.errors import ConfigError, SceneError
from airgs_codec.media.h264 import library_versions
from airgs_codec.media.metrics import mse, psnr
from airgs_codec.package.store import open_package
from airgs_codec.render import Camera, read_cameras, render
from airgs_codec.scene.gaussians import Gaussians
from airgs_codec.scene.ply import read_ply, write_ply
from airgs_codec.scene.sequence import GaussianSequence, open_sequence
from tools.baselines import mpeg_anchor_layout, v3_layout

TARGETS = "47,45.5,44,42.5,41,39.5"  # dB, of our packages
V3_QPS = (6, 10, 14, 18, 22, 26)
# The MPEG anchor's published rate points, finest first, from its lowest QPs up.
MPEG_QPS = (
    {"opacity": 1, "quaternions": 1, "log_scales": 1, "sh_dc": 1, "sh_rest": 4},
    {"opacity": 4, "quaternions": 4, "log_scales": 4, "sh_dc": 4, "sh_rest": 4},
    {"opacity": 4, "quaternions": 10, "log_scales": 10, "sh_dc": 4, "sh_rest": 16},
    {"opacity": 10, "quaternions": 16, "log_scales": 16, "sh_dc": 10, "sh_rest": 22},
    {"opacity": 16, "quaternions": 22, "log_scales": 22, "sh_dc": 16, "sh_rest": 28},
    {"opacity": 22, "quaternions": 28, "log_scales": 28, "sh_dc": 22, "sh_rest": 34},
)
STATIC_FORMATS = {"SPZ": "spz", "SOG": "sog", "compressed .ply": "compressed.ply"}


@dataclass(frozen=True, slots=True)
class RdPoint:
    """One coder at one setting. Seconds are for the whole sequence."""

    coder: str
    setting: str
    kb_per_frame: float
    psnr: float  # dB, against renderings of the input
    truth_psnr: float | None  # dB, against pictures taken of the scene
    encode_s: float
    decode_s: float


@dataclass(frozen=True, slots=True, eq=False)
class Bench:
    """The sequence, its repaired groups in Morton order, and what is measured on."""

    sequence: GaussianSequence
    groups: list[tuple[int, list[Gaussians]]]  # first frame, frames
    cameras: list[Camera]
    frames: list[int]
    references: dict[int, list[np.ndarray]]
    truth: dict[int, list[np.ndarray]]  # empty: no pictures

    def psnr_of(self, shown: dict[int, Gaussians]) -> tuple[float, float | None]:
        """Against renderings and against pictures, pooled over cameras and measured frames."""
        rendered = {frame: [render(shown[frame], camera).rgb for camera in self.cameras] for frame in self.frames}
        return _pooled(rendered, self.references), _pooled(rendered, self.truth) if self.truth else None


def _pooled(rendered: dict[int, list[np.ndarray]], wanted: dict[int, list[np.ndarray]]) -> float:
    pairs = [zip(pictures, wanted[frame], strict=True) for frame, pictures in rendered.items()]
    return psnr(float(np.mean([mse(a, b) for pair in pairs for a, b in pair])))


def read_truth(views: Path, cameras: Sequence[Camera], frames: Sequence[int]) -> dict[int, list[np.ndarray]]:
    """(H, W, 3) pictures in 0..1 of each frame seen by each camera; empty unless transforms.json names all of them."""
    entries = json.loads(views.read_text(encoding="utf-8"))["frames"]
    paths = {(e.get("camera"), e.get("time_index")): views.parent / e.get("file_path", "") for e in entries}
    wanted = {frame: [paths.get((camera.name, frame)) for camera in cameras] for frame in frames}
    if not all(path and path.is_file() for row in wanted.values() for path in row):
        return {}
    return {frame: [_read_picture(path) for path in row if path] for frame, row in wanted.items()}


def _read_picture(path: Path) -> np.ndarray:
    picture = cv2.imread(str(path))
    if picture is None:
        raise SceneError(f"{path}: expected a picture")
    return picture[..., ::-1].astype(np.float32) / 255


def open_bench(sequence: GaussianSequence, cameras: list[Camera], count: int, views: Path) -> Bench:
    """Read everything once; `count` frames are measured, first and last among them."""
    groups = []
    for start, stop in plan_groups(sequence).spans:
        frames = sequence.load(range(start, stop)).frames
        means = frames[len(frames) // 2].means.astype(np.float64)
        low, extent = means.min(axis=0), float(np.ptp(means, axis=0).max()) or 1.0
        order = np.argsort(morton_encode(((means - low) / extent * (2**16 - 1)).astype(np.int64)), kind="stable")
        groups.append((start, [frame.take(order) for frame in frames]))
    measured = evenly_spaced(len(sequence), count)
    references = {}
    for start, frames in groups:
        for i, frame in enumerate(frames, start):
            if i in measured:
                references[i] = [render(frame, camera).rgb for camera in cameras]
    return Bench(sequence, groups, cameras, measured, references, read_truth(views, cameras, measured))


def our_points(bench: Bench, targets: Sequence[float], keep_all: bool) -> Iterator[RdPoint]:
    """The top rung of a whole package: all tiers, sidecars, init segments and both manifests.

    Encoding counts the training views and, the first time, calibration; not the search for the target.
    """
    name = "airgs, keeps all" if keep_all else "airgs"
    for wanted in targets:
        with tempfile.TemporaryDirectory() as folder:
            target = Path(folder) / "package"
            settings = EncodeSettings(keep_all=keep_all, measure_frames=0)
            try:
                report = encode(bench.sequence, target, settings, goal=Goal(PSNR, wanted))
            except ConfigError as error:
                print(f"{name}: {error}")
                continue
            encode_s = report.survey_s + report.calibrate_s + report.encode_s
            package = open_package(target)
            m = package.manifest
            began = time.perf_counter()
            shown = {f.number: f.gaussians for f in decode_frames(package, 0, m.frames)}
            seconds = time.perf_counter() - began
            size = m.bytes_of(m.rung_files(0, 0)) + package.manifest_bytes
            kb = size / m.frames / 1e3
            yield RdPoint(name, f"{wanted:g} dB", kb, *bench.psnr_of(shown), encode_s, seconds)


def layout_points(bench: Bench) -> Iterator[RdPoint]:
    """Both layouts, group by group."""
    settings = [("V3 layout", f"qp {qp}", lambda frames, qp=qp: v3_layout(frames, qp)) for qp in V3_QPS]
    for i, qps in enumerate(MPEG_QPS):
        settings.append(("MPEG anchor layout", f"rate {i}", lambda frames, qps=qps: mpeg_anchor_layout(frames, qps)))
    for coder, name, code in settings:
        size, decode_s = 0, 0.0
        shown: dict[int, Gaussians] = {}
        began = time.perf_counter()
        for start, frames in bench.groups:
            coded = code(frames)
            size, decode_s = size + coded.bytes, decode_s + coded.decode_s
            shown |= dict(enumerate(coded.frames, start))
        encode_s = time.perf_counter() - began - decode_s
        quality = bench.psnr_of(shown)
        yield RdPoint(coder, name, size / len(bench.sequence) / 1e3, *quality, encode_s, decode_s)


def static_points(bench: Bench, command: str) -> Iterator[RdPoint]:
    """Every measured frame on its own through splat-transform; times scaled to the whole sequence."""
    scale = len(bench.sequence) / len(bench.frames)
    for name, ending in STATIC_FORMATS.items():
        size, encode_s, decode_s = 0, 0.0, 0.0
        shown: dict[int, Gaussians] = {}
        with tempfile.TemporaryDirectory() as folder:
            for frame in bench.frames:
                source, packed, back = (Path(folder) / f"{frame}{end}" for end in (".ply", f".{ending}", ".back.ply"))
                write_ply(source, next(f[frame - s] for s, f in bench.groups if s <= frame < s + len(f)))
                encode_s += _timed(command, source, packed)
                decode_s += _timed(command, packed, back)
                size += packed.stat().st_size
                shown[frame] = read_ply(back)
        kb = size / len(bench.frames) / 1e3
        yield RdPoint(name, "default", kb, *bench.psnr_of(shown), scale * encode_s, scale * decode_s)


def _timed(command: str, source: Path, target: Path) -> float:
    began = time.perf_counter()
    words = [*shlex.split(command), "--overwrite", "--quiet", str(source), str(target)]
    done = subprocess.run(words, check=False, capture_output=True, text=True, timeout=600)
    if done.returncode:
        raise ConfigError(f"{shlex.join(words)}: {(done.stderr or done.stdout).strip()[-300:]}")
    return time.perf_counter() - began


def bd_rate(ours: Sequence[RdPoint], theirs: Sequence[RdPoint], low: float = 0.0, high: float = 99.0) -> float | None:
    """Mean difference of log rate over the PSNR in [low, high] that both cover, as a share; None under 4 points.

    Points that another of the same curve beats at fewer bytes are left out: a rate curve must rise.
    """
    curves = [_rising(points) for points in (ours, theirs)]
    if min(len(c) for c in curves) < 4:
        return None
    low = max(low, *(c[0].psnr for c in curves))
    high = min(high, *(c[-1].psnr for c in curves))
    if high <= low:
        return None
    means = []
    for curve in curves:
        fit = PchipInterpolator([p.psnr for p in curve], [np.log(p.kb_per_frame) for p in curve])
        means.append(float(fit.integrate(low, high)) / (high - low))
    return float(np.expm1(means[0] - means[1]))


def _rising(points: Sequence[RdPoint]) -> list[RdPoint]:
    kept: list[RdPoint] = []
    for point in sorted(points, key=lambda p: p.kb_per_frame):
        if not kept or point.psnr > kept[-1].psnr:
            kept.append(point)
    return kept


def plot(points: Sequence[RdPoint], path: Path, title: str) -> None:
    """Bytes against PSNR, one curve a coder."""
    figure = new_figure(8, 5)
    axis = figure.subplots()
    for coder in dict.fromkeys(p.coder for p in points):
        curve = sorted((p for p in points if p.coder == coder), key=lambda p: p.kb_per_frame)
        x, y = [p.kb_per_frame for p in curve], [p.psnr for p in curve]
        ours = coder.startswith("airgs")
        axis.plot(x, y, "o--" if "keeps" in coder else "o-", label=coder, linewidth=2.5 if ours else 1.3)
    axis.set(xlabel="kB a frame, everything fetched", ylabel="PSNR, dB (render-referenced)", title=title, xscale="log")
    ticks = [10, 15, 20, 30, 50, 70, 100, 150, 200, 300, 500]
    axis.set_xticks(ticks, [str(t) for t in ticks])
    axis.minorticks_off()
    sizes = [p.kb_per_frame for p in points]
    axis.set_xlim(0.85 * min(sizes), 1.15 * max(sizes))
    axis.grid(alpha=0.3)
    axis.legend()
    save_figure(figure, path, dpi=110)


def main() -> None:
    """Run everything, write and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sequence", type=Path)
    parser.add_argument("--views", type=Path, required=True)
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--fps", type=Fraction)
    parser.add_argument("--frames", type=int, default=6, help="frames measured (default: 6)")
    parser.add_argument("--targets", default=TARGETS, help=f"PSNR of our packages, dB (default: {TARGETS})")
    parser.add_argument("--range", default="0:99", help="PSNR range of the BD-rate, dB (default: all)")
    parser.add_argument(
        "--splat-transform",
        metavar="COMMAND",
        help="measure SPZ, SOG and compressed .ply with this command, such as 'splat-transform -g cpu'",
    )
    args = parser.parse_args()
    args.output.mkdir(parents=True, exist_ok=True)
    sequence = open_sequence(args.sequence, views=args.views, fps=args.fps)
    cameras = [c for c in read_cameras(args.views) if c.split == "test"]
    bench = open_bench(sequence, cameras, args.frames, args.views)
    if bench.truth:
        print(f"the input against pictures of the scene: {_pooled(bench.references, bench.truth):.2f} dB")
    points = []
    targets = [float(part) for part in args.targets.split(",")]
    sources = [our_points(bench, targets, keep_all=False), our_points(bench, targets, keep_all=True)]
    sources += [layout_points(bench)]
    sources += [static_points(bench, args.splat_transform)] if args.splat_transform else []
    for source in sources:
        for p in source:
            points.append(p)
            figures = f"{p.kb_per_frame:8.2f} kB/frame  {p.psnr:6.2f} dB"
            figures += "" if p.truth_psnr is None else f" ({p.truth_psnr:.2f})"
            print(
                f"{p.coder:20} {p.setting:12} {figures}  enc {p.encode_s:7.2f} s  dec {p.decode_s:6.2f} s", flush=True
            )
    low, high = (float(part) for part in args.range.split(":"))
    rates = {}
    for coder, other in itertools.product(("airgs", "airgs, keeps all"), ("V3 layout", "MPEG anchor layout")):
        ours, theirs = ([p for p in points if p.coder == name] for name in (coder, other))
        rate = rates[f"{coder} against {other}"] = bd_rate(ours, theirs, low, high)
        words = "no common range" if rate is None else f"{100 * rate:+.1f} %"
        print(f"BD-rate of {coder} against {other}: {words}")
    machine = {"machine": platform.machine(), "python": platform.python_version(), **library_versions()}
    record = {"points": [asdict(p) for p in points], "bd_rate": rates, "range": [low, high], **machine}
    (args.output / "rd.json").write_text(json.dumps(record, indent=1) + "\n")
    with (args.output / "rd.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, list(asdict(points[0])))
        writer.writeheader()
        writer.writerows(asdict(p) for p in points)
    plot(points, args.output / "rd.png", f"{args.sequence.name}: {len(sequence)} frames")


if __name__ == "__main__":
    main()
