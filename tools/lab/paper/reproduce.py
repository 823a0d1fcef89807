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
from tools.lab import Lab, Page, PagePicture, Row, Section, Table, listed, setting
from tools.lab.baselines.airgs import PACKAGE
from tools.lab.paper import pictures
from tools.lab.paper.server import Server
from tools.lab.paper.streams import CHOOSERS, OURS, SERVER, Stored, Stream, airgs_levels, levels_of, stream
from tools.lab.paper.training import (
    ABLATIONS,
    METHODS,
    PAPER,
    SEEDED,
    SUMMED,
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
BETTER = ("v3", "3dgstream", "4dgs")  # methods that the paper means to be better than
CLAIMS = (  # of its abstract: a figure, the methods whose least one it is compared with, at most which share of that
    ("PSNR deviates over 20 % less", "deviation", BETTER, 0.8, "{:.2f} dB"),
    ("every frame has more than 30 dB", "lowest", (), 30, "{:.1f} dB at least"),
    ("training is 6 times as fast", "train_s_frame", ("4dgs",), 1 / 6, "{:.1f} s a frame"),
    ("a frame takes nearly 50 % fewer bytes", "kb_frame", ("v3",), 0.55, "{:.1f} kB"),
)  # of no methods: more than that


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
    sections = [Section(in_words(rows), "", [picture], [table])]
    if {PAPER, SEEDED, *BETTER} <= set(options.methods):
        sections.append(Section("\n".join(claims(rows)), "What of the abstract holds?"))
    sections.append(Section(how(options, subjects, trained, len(traces)), "How it was measured"))
    published = Table("paper-published", [dict(zip(PUBLISHED, row, strict=True)) for row in TABLE])
    return Page(sections, data=[Table("paper-streams", sent), Table("paper-levels", levels), published])


def folder(lab: Lab, subject: Subject, method: str) -> Path:
    return lab.folder / "scenes" / subject.name / method


def with_streams(rows: Rows, sent: Rows) -> Iterator[Row]:
    """The rows, each with what its stream shows: the paper's server's, else the paper's choice, else all it has."""
    for row in rows:
        mine = {s["chooser"]: s for s in sent if (s["scene"], s["method"]) == (row["scene"], row["method"])}
        chooser = next((name for name in (SERVER, "paper", "unpruned") if name in mine), None)
        shown = mine[chooser] if chooser else {}
        yield row | {"chooser": chooser, "psnr_screen": shown.get("psnr_screen"), "mean_ms": shown.get("mean_ms")}


def how(options: Options, subjects: Sequence[Subject], trained: Sequence[Trained], traces: int) -> str:
    parts = []
    for subject in subjects:
        views, scene = subject.footage(Path()).pictures.cameras(), subject.open()
        held = sum(view.held_out for view in views)
        size = f"{views[0].width} by {views[0].height}"
        parts.append(f"{subject.name}: {len(scene)} frames, {size}, {len(views) - held} cameras and {held} held out")
    seconds = sum(frame.seconds for t in trained for frame in t.frames)
    share = "its own iterations" if options.share == 1 else f"{options.share:.0%} of its iterations"
    return (
        f"{'. '.join(parts).capitalize()}. Each method has {share} and at most {options.rows:,} Gaussians a frame; all "
        f"took {seconds:,.0f} s of CPU time on a machine that did other work. Streams: {traces} LTE traces, from "
        f"{options.starts} moments of each; by the paper's choice every method skips a frame that does not fit."
    )


def in_words(rows: Rows) -> str:
    """What the paper's preset gives beside the sum of its temporal loss, and beside ours."""
    by = {(row["scene"], row["method"]): row for row in rows}
    scenes = list(dict.fromkeys(row["scene"] for row in rows))
    parts = ["airgs", PAPER, SUMMED]
    if not all((s, m) in by for s in scenes for m in parts):
        return ""
    fall, summed = (max((by[s, m]["fall"], s) for s in scenes) for m in parts[1:])
    ours, theirs = (
        listed([f"of {s} {by[s, m]['psnr']:.1f} dB in {by[s, m]['kb_frame']:.1f} kB" for s in scenes])
        for m in (parts[0], PAPER)
    )
    return (
        "The paper's method keeps up with motion if its loss against motion is a mean over Gaussians: no frame falls "
        f"more than {fall[0]:.1f} dB below the first of its group, where a sum over all values stops motion and "
        f"{summed[1]} falls {summed[0]:.1f} dB. With as many Gaussians at most, our default gives a frame {ours}, the "
        f"paper's method {theirs}."
    )


def claims(rows: Rows) -> Iterator[str]:
    """Each claim of the paper's abstract, whether it holds here, and the figures; a line of a list each."""
    by = {(row["scene"], row["method"]): row for row in rows}
    scenes = list(dict.fromkeys(row["scene"] for row in rows))
    for claim, key, others, most, form in CLAIMS:
        held, words = [], []
        for scene in scenes:
            least, name = min(((by[scene, m][key], m) for m in others), default=(None, ""))
            values = [by[scene, m][key] for m in (PAPER, SEEDED)]
            held += [[v > most if least is None else v <= most * least for v in values]]
            shown = [form.format(v) for v in (*values, *([] if least is None else [least]))]
            words.append(f"{scene} {shown[0]}, seeded {shown[1]}" + (f", {name} {shown[2]}" if name else ""))
        verdict = "holds" if all(h for h, _ in held) else "holds partly" if any(map(any, held)) else "does not hold"
        yield f"- {claim}: **{verdict}**. {'; '.join(words)}."


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
