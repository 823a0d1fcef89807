"""The paper's experiments with all methods in one run: quality, bytes, time, streaming.

Every method trains every scene from the same pictures into scenes/SCENE/METHOD of the folder, and is judged by the
scene's held-out cameras as its own viewer decodes it. Streams go over the traces in the paper's frame mode. What is
finished stays: the same command goes on after an interruption.

--quick takes at most four frames of a scene, 128 pixels large, with a few hundred iterations: what it prints shows that
everything works, and no more.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from airgs_codec.decoder.decode import decode_frames
from airgs_codec.package.package import open_package
from airgs_codec.play.trace import Trace
from airgs_codec.render.backend import CPU
from airgs_codec.scene.formats.ply import read_ply
from tools.lab import Lab, Page, PagePicture, Section, Table, setting, timed
from tools.lab.baselines.airgs import PACKAGE
from tools.lab.baselines.method import frame_path, mean_bytes
from tools.lab.paper import pictures
from tools.lab.paper.streams import OURS, airgs_levels, one_level, stream, streams_of
from tools.lab.paper.training import (
    METHODS,
    Subject,
    Trained,
    in_processes,
    parse_subject,
    row_of,
    train,
)

DATA = Path(__file__).parents[3] / "tests" / "data"
FOX = f"fox={DATA / 'fox_views'}"
PARTS = ("train", "stream", "published")
Rows = list[dict[str, Any]]


# Table 1 of arXiv 2512.20943, with the keyframe time of its Table 2: it stands beside ours, and is never mixed with it.
PUBLISHED = ("method", "psnr", "ssim", "mb_frame", "train_min_frame", "fps", "transmission_s", "keyframe_min")
TABLE = (
    ("NeuS2", 29.82, 0.961, 24.5, 3.7, 3, 0.139, 4.62),
    ("naive 3DGS", 33.94, 0.987, 18.3, 9.8, 200, 0.122, None),
    ("4DGS", 29.95, 0.971, 12.0, 9.0, 60, 0.131, None),
    ("3DGStream", 25.33, 0.944, 7.8, 0.75, 215, 0.063, None),
    ("V³", 27.69, 0.949, 2.0, 1.5, 387, 0.021, 2.98),
    ("AirGS", 32.29, 0.987, 1.1, 1.4, 400, 0.011, 0.61),
)
PROTOCOL = (
    "The paper: seven sequences of HiFi4G, 3840 x 2160, 81 cameras of which ten are held out, 30 frames a second, an "
    "RTX 3090, LTE driving traces. Here: other scenes, smaller pictures, two CPU cores. Only the order of methods and "
    "ratios within a table can be compared, and those with care. The paper contradicts itself: it names 90 frames a "
    "minute beside 11 ms a frame, and V³ with 2.0 and 1.9 MB, 11 and 12 ms."
)


@dataclass(frozen=True, slots=True)
class Options:
    scenes: tuple[str, ...] = setting((FOX,), "NAME=FOLDER[,frames=A:B][,size=PX][,near=Z][,held=CAMERA+CAMERA]")
    methods: tuple[str, ...] = setting(tuple(METHODS), "which are compared", choices=tuple(METHODS))
    traces: tuple[Path, ...] = setting((DATA / "fox" / "trace.csv",), "traces, or folders of them")
    show: tuple[str, ...] = setting((), "scenes whose pictures are shown side by side")
    name: str = setting("paper", "that names of pictures and tables begin with")
    only: tuple[str, ...] = setting(PARTS, "parts", choices=PARTS)
    jobs: int = setting(2, "processes, each on one core")
    quick: bool = setting(False, "four small frames, a few hundred iterations")


def run(options: Options, lab: Lab) -> Page:
    subjects = [parse_subject(text) for text in options.scenes]
    subjects = [s.quick() for s in subjects] if options.quick else subjects
    files = [f for path in options.traces for f in (sorted(path.iterdir()) if path.is_dir() else [path])]
    traces = [Trace.open(str(file)) for file in files]
    jobs = [(s, m, options.quick, folder(lab, s, m)) for s in subjects for m in options.methods]
    trained = in_processes(train, jobs, options.jobs, lab.progress)
    first = quality(subjects, trained, lab, options)
    sections, data = [replace(first, tables=[])], [*first.tables]
    if "stream" in options.only:
        rows = [row for s in subjects for row in streams(lab, s, trained, traces, 2 if options.quick else 8)]
        picture = PagePicture(
            f"{options.name}-times",
            "How long frames take; one that is skipped never comes",
            partial(pictures.draw_times, rows),
        )
        rate = float(np.mean([trace.mean_bps for trace in traces]))
        times = [
            time_of_frame(lab, s, t, rate) for s in subjects for t in trained if t.scene == s.name and t.method in OURS
        ]
        tables = [Table(f"{options.name}-streams", rows), Table(f"{options.name}-overhead", times)]
        data += tables
        sections.append(Section(streamed_in_words(rows, len(traces)), "Streams, frame by frame", [picture]))
    if "published" in options.only:
        data.append(Table(f"{options.name}-published", [dict(zip(PUBLISHED, row, strict=True)) for row in TABLE]))
        sections.append(Section(PROTOCOL, "What the paper publishes"))
    return Page(sections, data=data)


def folder(lab: Lab, subject: Subject, method: str) -> Path:
    return lab.folder / "scenes" / subject.name / method


def quality(subjects: Sequence[Subject], trained: Sequence[Trained], lab: Lab, options: Options) -> Section:
    """Tables 1 and 2, with their pictures: over time, over bytes, side by side."""
    rates = {subject.name: float(subject.open().fps) for subject in subjects}
    rows = [row_of(t, rates[t.scene]) for t in trained]
    panels, bubbles = (5.2 * len(rates), 3.8), "PSNR over bytes; areas are seconds of training a frame"
    some = [
        PagePicture(f"{options.name}-quality", "PSNR of every frame", partial(pictures.draw_quality, trained), panels),
        PagePicture(f"{options.name}-sizes", bubbles, partial(pictures.draw_sizes, rows), panels),
    ]
    sheet = {subject.name: side_by_side(subject, trained, lab) for subject in subjects if subject.name in options.show}
    if sheet:
        size = 2.4 * max(map(len, sheet.values())), 2.6 * len(sheet)
        draw = partial(pictures.draw_side_by_side, sheet)
        caption = "The middle frame from a held-out camera"
        some.append(PagePicture(f"{options.name}-side-by-side", caption, draw, size))
    tables = [Table(f"{options.name}-methods", rows)]
    return Section(in_words(rows), "Quality, size and time", some, tables)


def side_by_side(subject: Subject, trained: Sequence[Trained], lab: Lab) -> dict[str, Any]:
    """Pictures (H, W, 3) of the middle frame from the first held-out camera: the one taken, then each method's."""
    mine = [t for t in trained if t.scene == subject.name]
    number = len(mine[0].frames) // 2
    view = subject.footage(lab.folder).pictures.held_out(number)[0]
    shown = {"taken": np.clip(view.target.rgb, 0, 1)}
    for t in mine:
        gaussians = read_ply(frame_path(folder(lab, subject, t.method), number))
        shown[t.method] = np.clip(CPU.load(gaussians).draw(view.camera).rgb, 0, 1)
    return shown


def in_words(rows: Rows) -> str:
    """How far airgs is from the best method of each scene, and from the smallest of the others."""
    sentences = []
    for scene in dict.fromkeys(row["scene"] for row in rows):
        by_method = {row["method"]: row for row in rows if row["scene"] == scene}
        others = [row for name, row in by_method.items() if name not in OURS]
        if "airgs" not in by_method or not others:
            continue
        ours, best = by_method["airgs"], max(others, key=lambda row: row["psnr"])
        small = min(others, key=lambda row: row["kb_frame"])
        gap = ours["psnr"] - best["psnr"]
        beside = f"{abs(gap):.2f} dB {'above' if gap > 0 else 'under'} {best['method']}, the best of the others"
        sentences.append(
            f"On {scene} airgs has {ours['psnr']:.2f} dB, {beside}, with {best['kb_frame'] / ours['kb_frame']:.1f} "
            f"times fewer bytes; {small['method']}, the smallest of them, takes "
            f"{small['kb_frame'] / ours['kb_frame']:.1f} times as many for {small['psnr']:.2f} dB."
        )
        other = [row for name, row in by_method.items() if name in OURS and name != "airgs"]
        sentences += [f"{row['method']} has {row['psnr']:.2f} dB at {row['kb_frame']:.1f} kB a frame." for row in other]
    return " ".join(sentences)


def streamed_in_words(rows: Rows, traces: int) -> str:
    """Which way of airgs shows most on the screen of each scene, beside the best of the others."""
    sentences = []
    for scene in dict.fromkeys(row["scene"] for row in rows):
        some = [row for row in rows if row["scene"] == scene and not np.isnan(row["psnr_screen"])]
        ours = [row for row in some if row["method"] in OURS]
        others = [row for row in some if row["method"] not in OURS]
        if not ours or not others:
            continue
        mine, best = (max(part, key=lambda row: row["psnr_screen"]) for part in (ours, others))
        sentences.append(
            f"{scene}: {mine['method']} by {mine['chooser']} shows {mine['psnr_screen']:.2f} dB, {best['method']}, the "
            f"best of the others, {best['psnr_screen']:.2f}."
        )
    return f"Over {traces} traces. {' '.join(sentences)}"


def streams(lab: Lab, subject: Subject, trained: Sequence[Trained], traces: Sequence[Trace], offsets: int) -> Rows:
    mine = [t for t in trained if t.scene == subject.name]

    def make() -> Rows:
        shown, rows = subject.footage(lab.folder).pictures, []
        fps = float(subject.open().fps)
        for t in mine:
            place = folder(lab, subject, t.method)
            if t.method in OURS:
                levels = airgs_levels(open_package(place / PACKAGE), shown)
            else:
                frames = [read_ply(frame_path(place, n)) for n in range(len(t.frames))]
                levels = (one_level(t.frames, frames, shown),)
            rows += [stream(one, traces, offsets, fps) for one in streams_of(t.method, levels)]
        return [{"scene": subject.name} | row for row in rows]

    reads = {"trained": [asdict(t) for t in mine], "traces": [[t.name, t.mean_bps] for t in traces]}
    return lab.results.once("streams", reads | {"subject": subject.words(), "offsets": offsets}, make)


def time_of_frame(lab: Lab, subject: Subject, trained: Trained, rate_bps: float) -> dict[str, Any]:
    """Milliseconds of a frame in the top rung: over the link at its mean rate, decoding and drawing on one core."""
    package = open_package(folder(lab, subject, trained.method) / PACKAGE)
    frames = package.manifest.frames
    (took,) = timed(lambda: sum(1 for _ in decode_frames(package, 0, frames)), 1)
    link = 8e3 * mean_bytes(trained.frames) / rate_bps
    times = {"link": link, "decode": 1e3 * took.wall / frames, "draw": 1e3 / trained.fps}
    return {"scene": subject.name, "method": trained.method} | times
