"""What the four methods beside ours are: their settings here and in their papers, and the two layouts of V^3.

V^3's script for scales and opacities that are activated is the one that its README names; the other codes them as they
are stored. Both code the rows of every scene in Morton order at the preset of x264 that airgs uses; PSNR compares with
pictures of the original Gaussians from the held-out cameras, pooled over cameras and frames.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from airgs_codec.render import read_cameras
from airgs_codec.scene.sequence import open_sequence
from tools.lab import Lab, Page, Row, Section, Table, required, setting
from tools.lab.baselines.fourdgs import Fourdgs
from tools.lab.baselines.stream3dgs import StreamSettings
from tools.lab.baselines.threedgs import GRADIENT, ITERATIONS, RATES, Naive3dgs
from tools.lab.baselines.v3 import V3Settings
from tools.lab.made import name_of
from tools.lab.rd.coders import PRESETS, layout_trials, v3_name
from tools.lab.rd.experiment import measure
from tools.lab.rd.layouts import V3_FORMS
from tools.lab.rd.subject import RdPoint, Trial, open_subject

SETTINGS = {"method": ("method", ""), "what": ("setting", ""), "here": ("here", ""), "paper": ("in the paper", "")}
COLUMNS = {"scene": ("scene", ""), "qp": ("QP", "d")} | {
    f"{form}_{unit}": (f"{form}, {words}", ".1f") for form in V3_FORMS for unit, words in (("db", "dB"), ("kb", "kB"))
}


@dataclass(frozen=True, slots=True)
class Options:
    scenes: tuple[str, ...] = required("sequences with their cameras, SCENE=VIEWS")
    qps: tuple[int, ...] = setting((6, 14, 22), "some of those at which they are compared with airgs")
    frames: int = setting(6, "frames measured")


def run(options: Options, lab: Lab) -> Page:
    rows: list[Row] = []
    for scene in options.scenes:
        place, _, views = scene.partition("=")
        cameras = [camera for camera in read_cameras(Path(views)) if camera.held_out]
        subject = open_subject(open_sequence(place, views=views), cameras, options.frames, Path(views))
        rows += rows_of(name_of(scene), options.qps, list(measure(subject, trials(options.qps), lab)))
    return page(rows)


def trials(qps: Sequence[int]) -> Iterator[Trial]:
    coders = [v3_name(form, PRESETS[-1]) for form in V3_FORMS]
    return (one for one in layout_trials() if one.coder in coders and one.setting in [f"qp {qp}" for qp in qps])


def rows_of(scene: str, qps: Sequence[int], points: Sequence[RdPoint]) -> list[Row]:
    found = {(point.coder, point.setting): point for point in points}
    rows: list[Row] = []
    for qp in qps:
        row: Row = {"scene": scene, "qp": qp}
        for form in V3_FORMS:
            point = found[v3_name(form, PRESETS[-1]), f"qp {qp}"]
            row |= {f"{form}_db": point.psnr, f"{form}_kb": point.kb_per_frame}
        rows.append(row)
    return rows


def page(rows: Sequence[Row]) -> Page:
    settings = [
        {"method": method, "what": what, "here": shown(here), "paper": shown(paper)}
        for method, what, here, paper in settings_of()
        if here != paper
    ]
    tables = [Table("rivals", settings, SETTINGS), Table("v3-layouts", rows, COLUMNS)]
    return Page([Section("", tables=tables)])


def settings_of() -> list[tuple[str, str, float, float | str]]:
    """Method, setting, its value here and in the paper; the page shows those that differ."""
    naive, four, stream, v3 = Naive3dgs(), Fourdgs(), StreamSettings(), V3Settings()
    return [
        ("naive 3DGS", "iterations a frame", naive.iterations, ITERATIONS),
        ("naive 3DGS", "gradient from which Gaussians are added", naive.gradient, GRADIENT),
        ("naive 3DGS", "factor on learning rates", naive.rate, RATES.factor),
        ("4DGS", "iterations in all", four.iterations, 17_000),
        ("4DGS", "gradient from which Gaussians are added", four.gradient, GRADIENT),
        ("3DGStream", "iterations of the cache, a frame", stream.iterations, 150),
        ("3DGStream", "iterations of what is added, a frame", stream.added_iterations, 100),
        ("3DGStream", "levels of the hash grid", stream.cache.levels, 16),
        ("3DGStream", "entries of a level", 2**stream.cache.log2_table, 2**15),
        ("3DGStream", "share of 1 - SSIM in the loss", stream.first.ssim_weight, 0.2),
        ("3DGStream", "Gaussians that a frame adds, at most", stream.most_added, "all"),
        ("V³", "iterations of a keyframe", v3.keyframe_iterations + v3.finetune_iterations, 16_000),
        ("V³", "iterations of the hash grid, a frame", v3.field_iterations, 800),
        ("V³", "iterations of the attributes, a frame", v3.frame_iterations, 2_000),
        ("V³", "frames of a group", v3.group_frames, 20),
        ("V³", "Gaussians of a keyframe, at most", v3.rows, "all"),
    ]


def shown(value: float | str) -> str:
    return value if isinstance(value, str) else f"{value:,}" if isinstance(value, int) else f"{value:g}"
