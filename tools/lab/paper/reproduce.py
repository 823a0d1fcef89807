"""The paper's experiments with all methods in one run: quality, bytes, time, streaming, ablations.

Every method trains every scene from the same pictures into scenes/SCENE/METHOD of the folder, and is judged by the
scene's held-out cameras as its own viewer decodes it. Streams go over the traces in the paper's frame mode. What is
finished stays: the same command goes on after an interruption. What pruning costs is the experiment `dense`, with the
package and the model of a scene.

--quick takes at most four frames of a scene, 128 pixels large, with a few hundred iterations: what it prints shows that
everything works, and no more.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from airgs_codec._settings import setting
from airgs_codec.decoder.decode import decode_frames
from airgs_codec.package.package import open_package
from airgs_codec.play.trace import Trace
from airgs_codec.scene.formats.ply import read_ply
from tools.lab.baselines.airgs import PACKAGE
from tools.lab.baselines.method import frame_path
from tools.lab.options import expect_names
from tools.lab.page import Page, Picture, Section, Table
from tools.lab.paper import pictures
from tools.lab.paper.ablations import SIZE, Ablation, ablate, changes, shortened
from tools.lab.paper.methods import METHODS, trainer_settings
from tools.lab.paper.scenes import Subject, parse_subject
from tools.lab.paper.streams import OURS, airgs_levels, one_level, stream, streams_of
from tools.lab.paper.training import Job, Trained, in_processes, row_of, train
from tools.lab.timing import timed

if TYPE_CHECKING:
    from tools.lab.command import Lab

DATA = Path(__file__).parents[3] / "tests" / "data"
FOX = f"fox={DATA / 'fox_views'}"
PARTS = ("train", "stream", "ablate")
METHOD_COLUMNS = {
    "scene": ("scene", ""), "method": ("method", ""), "psnr": ("PSNR, dB", ".2f"), "worst": ("worst frame, dB", ".2f"),
    "deviation": ("mean deviation, dB", ".2f"), "most_deviation": ("largest, dB", ".2f"), "ssim": ("SSIM", ".3f"),
    "kb_frame": ("kB a frame", ".1f"), "gaussians": ("Gaussians", ",.0f"),
    "train_s_frame": ("training, s a frame", ".1f"), "key_s": ("keyframe, s", ".1f"),
    "fps": ("pictures a second", ".0f"),
}  # fmt: skip
STREAM_COLUMNS = {
    "scene": ("scene", ""), "method": ("method", ""), "chooser": ("levels", ""), "kb_frame": ("kB a frame sent", ".1f"),
    "psnr": ("PSNR sent, dB", ".2f"), "mean_ms": ("mean, ms", ".1f"), "p95_ms": ("95 %, ms", ".1f"),
    "worst_ms": ("worst, ms", ",.0f"), "late": ("late", ".1%"), "skipped": ("skipped", ".1%"),
    "stale": ("older picture", ".1%"), "blank": ("none", ".1%"), "psnr_screen": ("PSNR on the screen, dB", ".2f"),
}  # fmt: skip
TIME_COLUMNS = {
    "scene": ("scene", ""), "link": ("link, ms", ".1f"), "decode": ("decoding, ms", ".1f"),
    "draw": ("drawing, ms", ".1f"),
}  # fmt: skip
ABLATION_COLUMNS = {
    "question": ("question", ""), "name": ("change", ""), "psnr": ("PSNR, dB", ".2f"),
    "worst": ("worst frame, dB", ".2f"), "kb_frame": ("kB a frame", ".1f"), "keys": ("keyframes", "d"),
    "gaussians": ("Gaussians at the end", ",d"), "train_s_frame": ("training, s a frame", ".1f"), "note": ("", ""),
}  # fmt: skip
PUBLISHED_COLUMNS = {
    "method": ("method, as published", ""), "psnr": ("PSNR, dB", ".2f"), "ssim": ("SSIM", ".3f"),
    "mb_frame": ("MB a frame", ".1f"), "train_min_frame": ("training, min a frame", ".2f"), "fps": ("FPS", ".0f"),
    "transmission_s": ("transmission, s", ".3f"), "key_min": ("keyframe, min", ".2f"),
}  # fmt: skip
Rows = list[dict[str, Any]]


@dataclass(frozen=True, slots=True)
class Published:
    """A row of Table 1 of arXiv 2512.20943, with the keyframe time of its Table 2: shown beside ours, never mixed."""

    method: str
    psnr: float  # dB
    ssim: float
    mb_frame: float
    train_min_frame: float
    fps: float
    transmission_s: float
    key_min: float | None


TABLE = (
    Published("NeuS2", 29.82, 0.961, 24.5, 3.7, 3, 0.139, 4.62),
    Published("naive 3DGS", 33.94, 0.987, 18.3, 9.8, 200, 0.122, None),
    Published("4DGS", 29.95, 0.971, 12.0, 9.0, 60, 0.131, None),
    Published("3DGStream", 25.33, 0.944, 7.8, 0.75, 215, 0.063, None),
    Published("V³", 27.69, 0.949, 2.0, 1.5, 387, 0.021, 2.98),
    Published("AirGS", 32.29, 0.987, 1.1, 1.4, 400, 0.011, 0.61),
)
PROTOCOL = (
    "The paper: seven sequences of HiFi4G, 3840 x 2160, 81 cameras of which ten are held out, 30 frames a second, an "
    "RTX 3090, LTE driving traces. Here: other scenes, smaller pictures, two CPU cores. Only the order of methods and "
    "ratios within a table can be compared, and those with care."
)


@dataclass(frozen=True, slots=True)
class Options:
    """What is run."""

    scenes: tuple[str, ...] = setting((FOX,), "NAME=FOLDER[,frames=A:B][,size=PX][,near=Z]")
    methods: tuple[str, ...] = setting(tuple(METHODS), f"some of {', '.join(METHODS)}")
    traces: tuple[Path, ...] = setting((DATA / "fox" / "trace.csv",), "traces, or folders of them")
    ablated: str = setting(FOX, "scene of the ablations, of 160 pixels unless told")
    only: tuple[str, ...] = setting(PARTS, f"some of {', '.join(PARTS)}")
    jobs: int = setting(2, "processes, each on one core")
    quick: bool = setting(False, "four small frames, a few hundred iterations")


def run(options: Options, lab: Lab) -> Page:
    """All parts that are asked for. Raises AirgsError."""
    expect_names("--methods", options.methods, tuple(METHODS))
    expect_names("--only", options.only, PARTS)
    subjects = [parse_subject(text) for text in options.scenes]
    subjects = [s.quick() for s in subjects] if options.quick else subjects
    ablated = parse_subject(options.ablated)
    ablated = ablated.quick() if options.quick else replace(ablated, size=ablated.size or SIZE)
    files = [f for path in options.traces for f in (sorted(path.iterdir()) if path.is_dir() else [path])]
    traces = [Trace.open(str(file)) for file in files]
    jobs = [Job(s, m, options.quick, folder(lab, s, m)) for s in subjects for m in options.methods]
    trained = in_processes(train, jobs, options.jobs, lab.progress)
    sections = [quality(trained)]
    if "stream" in options.only:
        rows = [row for s in subjects for row in streams(lab, s, trained, traces, 2 if options.quick else 8)]
        picture = Picture(
            "times", "How long frames take; one that is skipped never comes", partial(pictures.draw_times, rows)
        )
        sections.append(Section("", "Streams, frame by frame", [picture], [Table("streams", rows, STREAM_COLUMNS)]))
        if OURS in options.methods:
            rate = float(np.mean([trace.mean_bps for trace in traces]))
            times = [time_of_frame(lab, s, trained, rate) for s in subjects]
            sections.append(Section("", "Time of a frame", tables=[Table("overhead", times, TIME_COLUMNS)]))
    if "ablate" in options.only:
        settings = trainer_settings(ablated, options.quick)
        settings = settings if options.quick else shortened(settings)
        calls = [Ablation(ablated, change, lab.folder / "ablations") for change in changes(settings)]
        rows = in_processes(ablate, calls, options.jobs, lab.progress)
        picture = Picture("ablations", "What every change moves", partial(pictures.draw_ablations, rows), (10, 5.5))
        sections.append(Section("", "Ablations", [picture], [Table("ablations", rows, ABLATION_COLUMNS)]))
    published = Table("published", [asdict(row) for row in TABLE], PUBLISHED_COLUMNS)
    return Page([*sections, Section(PROTOCOL, "What the paper publishes", tables=[published])])


def folder(lab: Lab, subject: Subject, method: str) -> Path:
    """Of a method's run on a scene."""
    return lab.folder / "scenes" / subject.name / method


def quality(trained: Sequence[Trained]) -> Section:
    """Tables 1 and 2, with their pictures."""
    rows = [row_of(t) for t in trained]
    width = 5.2 * len({row["scene"] for row in rows})
    some = [
        Picture("quality", "PSNR of every frame", partial(pictures.draw_quality, trained), (width, 3.8)),
        Picture("sizes", "PSNR over bytes", partial(pictures.draw_sizes, rows), (width, 3.8)),
    ]
    return Section("", "Quality, size and time", some, [Table("methods", rows, METHOD_COLUMNS)])


def streams(lab: Lab, subject: Subject, trained: Sequence[Trained], traces: Sequence[Trace], offsets: int) -> Rows:
    """Every method's stream of a scene over all traces."""
    mine = [t for t in trained if t.scene == subject.name]

    def make() -> Rows:
        shown, rows = subject.footage(lab.folder).pictures, []
        fps = float(subject.open().fps)
        for t in mine:
            place = folder(lab, subject, t.method)
            if t.method == OURS:
                levels = airgs_levels(open_package(place / PACKAGE), shown)
            else:
                frames = [read_ply(frame_path(place, n)) for n in range(len(t.frames))]
                levels = (one_level(t.frames, frames, shown),)
            rows += [stream(one, traces, offsets, fps) for one in streams_of(t.method, levels)]
        return [{"scene": subject.name} | row for row in rows]

    reads = {"trained": [asdict(t) for t in mine], "traces": [[t.name, t.mean_bps] for t in traces]}
    return lab.results.once("streams", reads | {"subject": subject.words(), "offsets": offsets}, make)


def time_of_frame(lab: Lab, subject: Subject, trained: Sequence[Trained], rate_bps: float) -> dict[str, Any]:
    """Milliseconds of a frame in the top rung: over the link at its mean rate, decoding and drawing on one core."""
    row = next(row_of(t) for t in trained if (t.scene, t.method) == (subject.name, OURS))
    package = open_package(folder(lab, subject, OURS) / PACKAGE)
    frames = package.manifest.frames
    (took,) = timed(lambda: sum(1 for _ in decode_frames(package, 0, frames)), 1)
    link, draw = 8e6 * row["kb_frame"] / rate_bps, 1e3 / row["fps"]
    return {"scene": subject.name, "link": link, "decode": 1e3 * took.wall / frames, "draw": draw}
