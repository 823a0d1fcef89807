"""The paper's experiments with all methods in one run: quality, bytes, time, streaming, at one cap of Gaussians.

Every method trains every scene from the same pictures into scenes/SCENE/METHOD of the folder, and is judged by the
scene's held-out cameras as its own viewer decodes it. So do the paper's preset with one thing changed, and ours with
the paper's rule for keyframes. Streams go over the traces in the paper's frame mode. What is finished stays: the same
command goes on after an interruption.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

import numpy as np

from airgs_codec.package.package import open_package
from airgs_codec.play.trace import Trace
from tools.lab import Lab, Page, PagePicture, Row, Section, Table, setting
from tools.lab.baselines.airgs import PACKAGE
from tools.lab.paper import pictures
from tools.lab.paper.server import Server
from tools.lab.paper.streams import CHOOSERS, OURS, SERVER, Stored, Stream, airgs_levels, levels_of, stream
from tools.lab.paper.training import (
    ABLATIONS,
    METHODS,
    PAPER,
    Means,
    Subject,
    Trained,
    in_processes,
    parse_subject,
    row_of,
    train,
)

DATA = Path(__file__).parents[3] / "tests" / "data"
FOX = f"fox={DATA / 'fox_views'}"
Rows = list[Row]

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
COLUMNS = {
    "scene": ("scene", ""), "method": ("method", ""), "psnr": ("dB", ".1f"), "lowest": ("lowest frame", ".1f"),
    "fall": ("fall in a group", ".1f"), "deviation": ("deviation", ".2f"), "kb_frame": ("kB a frame", ".1f"),
    "gaussians": ("Gaussians, most", "d"), "train_s_frame": ("CPU s a frame", ".1f"), "chooser": ("sent by", ""),
    "psnr_screen": ("dB on the screen", ".1f"), "mean_ms": ("ms a frame", ".0f"),
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Options:
    scenes: tuple[str, ...] = setting((FOX,), "NAME=FOLDER[,frames=A:B][,size=PX][,near=Z][,held=CAMERA+CAMERA]")
    methods: tuple[str, ...] = setting(tuple(METHODS), "which are compared", choices=tuple(METHODS))
    traces: tuple[Path, ...] = setting((DATA / "fox" / "trace.csv",), "traces, or folders of them")
    rows: int = setting(4_500, "most Gaussians that a viewer of any method has of a frame")
    share: float = setting(1.0, "share of the iterations of every method")
    starts: int = setting(2, "moments of each trace at which streams start")
    jobs: int = setting(1, "processes, each on one core")


def run(options: Options, lab: Lab) -> Page:
    subjects = [parse_subject(text) for text in options.scenes]
    files = [f for path in options.traces for f in (sorted(path.iterdir()) if path.is_dir() else [path])]
    traces = [Trace.open(str(file)) for file in files]
    jobs = [(s, m, Means(options.rows, options.share), folder(lab, s, m)) for s in subjects for m in options.methods]
    trained = in_processes(train, jobs, options.jobs, lab.progress)
    rows = [row_of(t) for t in trained]
    streamed = [streams(lab, s, trained, traces, options.starts) for s in subjects]
    sent, levels = ([row for part in parts for row in part] for parts in zip(*streamed, strict=True))
    size = (5.2 * len(subjects), 4.2)
    picture = PagePicture("paper-quality", "PSNR of every frame", partial(pictures.draw_quality, trained), size)
    table = Table("paper-methods", list(with_streams(rows, sent)), COLUMNS)
    published = Table("paper-published", [dict(zip(PUBLISHED, row, strict=True)) for row in TABLE])
    data = [Table("paper-streams", sent), Table("paper-levels", levels), published]
    return Page([Section("", "", [picture], [table])], how(options, subjects, len(traces)), data=data)


def folder(lab: Lab, subject: Subject, method: str) -> Path:
    return lab.folder / "scenes" / subject.name / method


def with_streams(rows: Rows, sent: Rows) -> Iterator[Row]:
    """The rows, each with what its stream shows: the paper's server's, else the paper's choice, else all it has."""
    for row in rows:
        mine = {s["chooser"]: s for s in sent if (s["scene"], s["method"]) == (row["scene"], row["method"])}
        chooser = next((name for name in (SERVER, "paper", "unpruned") if name in mine), None)
        shown = mine[chooser] if chooser else {}
        yield row | {"chooser": chooser, "psnr_screen": shown.get("psnr_screen"), "mean_ms": shown.get("mean_ms")}


def how(options: Options, subjects: Sequence[Subject], traces: int) -> str:
    parts = []
    for subject in subjects:
        views, scene = subject.footage(Path()).pictures.cameras(), subject.open()
        held = sum(view.held_out for view in views)
        size = f"{views[0].width} by {views[0].height}"
        parts.append(f"{subject.name}: {len(scene)} frames, {size}, {len(views) - held} cameras and {held} held out")
    return (
        f"{'. '.join(parts)}. At most {options.rows:,} Gaussians a frame; streams over {traces} traces, from "
        f"{options.starts} moments of each; by the paper's choice every method skips a frame that does not fit."
    )


def streams(
    lab: Lab, subject: Subject, trained: Sequence[Trained], traces: Sequence[Trace], starts: int
) -> tuple[Rows, Rows]:
    """What the methods of a scene show when they are sent, but for those with one thing changed; the paper's levels."""
    mine = [t for t in trained if t.scene == subject.name and t.method not in {*ABLATIONS} - {*OURS}]

    def make() -> tuple[Rows, Rows]:
        pictures, fps = subject.footage(lab.folder).pictures, float(subject.open().fps)
        rows, levels = list[Row](), list[Row]()
        for t in mine:
            place = folder(lab, subject, t.method)
            if t.method not in OURS:
                stored = Stored(levels_of(place, t.frames, pictures))
                ways = [Stream(t.method, name, stored) for name in ("unpruned", "paper")]
            else:
                package = open_package(place / PACKAGE)
                stored = Stored(airgs_levels(package, pictures))
                ways = [Stream(t.method, name, stored) for name in CHOOSERS if name != SERVER]
                if t.method == PAPER:
                    ways.append(Stream(PAPER, SERVER, Server(package, pictures)))
                    for one, level in zip(package.manifest.levels, stored.of_all, strict=True):
                        shown = {"kb_frame": float(level.sizes.mean() / 1e3), "psnr": float(np.diag(level.psnr).mean())}
                        levels.append({"withheld": one.pruned} | shown)
            rows += [stream(one, traces, starts, fps) for one in ways]
        return [{"scene": subject.name} | row for row in rows], [{"scene": subject.name} | row for row in levels]

    reads = {"trained": [asdict(t) for t in mine], "traces": [[t.name, t.mean_bps] for t in traces]}
    return lab.results.once("streams", reads | {"subject": subject.words(), "starts": starts}, make)
