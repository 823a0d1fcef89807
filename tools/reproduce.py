"""The paper's experiments with all methods in one run: quality, bytes, time, streaming, pruning, ablations.

    python -m tools.reproduce -o OUT [--scene NAME=FOLDER[,frames=A:B][,size=PX][,near=Z] ...] [--traces PATH ...]
        [--methods airgs,v3,...] [--only train,stream,prune,ablate] [--ablate NAME=FOLDER...] [--jobs N] [--quick]

Every method trains every scene from the same pictures into OUT/scenes/SCENE/METHOD, and is judged by the scene's
held-out cameras as its own viewer decodes it. Streams go over the traces in the paper's frame mode. What is finished
stays: the same command goes on after an interruption. Writes methods.csv, streams.csv, pruning.csv, ablations.csv,
their pictures, results.json, tables.md and index.html. Without --scene it is the embedded fox of six frames.

--quick takes at most four frames of a scene, 128 pixels large, with a few hundred iterations: what it prints shows that
everything works, and no more.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

import numpy as np

from airgs_codec._files import write_json
from airgs_codec.cli.common import Bar, run_command
from airgs_codec.errors import ConfigError
from airgs_codec.jobs.engines import prepare_worker
from airgs_codec.package.store import open_package
from airgs_codec.play.trace import Trace, open_trace
from airgs_codec.scene.ply import read_ply
from airgs_codec.scene.sequence import open_sequence
from airgs_codec.train.settings import TrainSettings
from tools.baselines.airgs import MODEL, PACKAGE
from tools.baselines.method import frame_path
from tools.reproduction.ablations import SIZE, Outcome, ablate, names, shortened
from tools.reproduction.kept import KeptParts
from tools.reproduction.methods import METHODS, trainer_settings
from tools.reproduction.pictures import plot_ablations, plot_pruning, plot_quality, plot_sizes, plot_times
from tools.reproduction.pruning import measure_pruning, time_of_frame
from tools.reproduction.report import machine, published_table, write_csv, write_markdown, write_page
from tools.reproduction.scenes import Subject, parse_subject
from tools.reproduction.streams import Stream, airgs_levels, one_level, stream_all
from tools.reproduction.training import Job, Row, Trained, as_table, row_of, train_all

DATA = Path(__file__).parent.parent / "tests" / "data"
EMBEDDED = Subject("fox", DATA / "fox_views")
PARTS = ("train", "stream", "prune", "ablate")
OURS = "airgs"
CHOOSERS = ("unpruned", "paper", "paper-no-cliff", "paper-literal")  # of AirGS; the others have one size a frame
METHOD_COLUMNS = {
    "scene": "scene", "method": "method", "psnr": "PSNR, dB", "worst": "worst frame, dB",
    "deviation": "mean deviation, dB", "most_deviation": "largest, dB", "ssim": "SSIM", "kb_frame": "kB a frame",
    "gaussians": "Gaussians", "train_s_frame": "training, s a frame", "key_s": "keyframe, s",
    "fps": "pictures a second",
}  # fmt: skip
STREAM_COLUMNS = {
    "scene": "scene", "method": "method", "chooser": "levels", "kb_frame": "kB a frame sent", "psnr": "PSNR sent, dB",
    "paper_mean_ms": "mean, ms", "paper_p95_ms": "95 %, ms", "worst_ms": "worst, ms", "late": "late",
    "skipped": "skipped", "stale": "older picture", "blank": "none", "psnr_screen": "PSNR on the screen, dB",
}  # fmt: skip
OVERHEAD_COLUMNS = {"scene": "scene", "link": "link, ms", "decode": "decoding, ms", "draw": "drawing, ms"}
ABLATION_COLUMNS = {
    "question": "question", "name": "change", "psnr": "PSNR, dB", "worst": "worst frame, dB",
    "kb_frame": "kB a frame", "keys": "keyframes", "gaussians": "Gaussians at the end",
    "train_s_frame": "training, s a frame",
}  # fmt: skip
PUBLISHED_COLUMNS = {
    "method": "method, as published", "psnr": "PSNR, dB", "ssim": "SSIM", "mb_frame": "MB a frame",
    "train_min_frame": "training, min a frame", "fps": "FPS", "transmission_s": "transmission, s",
    "key_min": "keyframe, min",
}  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """What is run."""

    output: Path
    subjects: tuple[Subject, ...]
    methods: tuple[str, ...]
    traces: tuple[Trace, ...]
    ablated: Subject
    parts: tuple[str, ...]
    quick: bool
    jobs: int

    @property
    def kept(self) -> KeptParts:
        """Where finished parts lie."""
        return KeptParts(self.output / "parts")

    @property
    def mean_rate(self) -> float:
        """Bits a second, mean over traces."""
        return float(np.mean([trace.mean_bps for trace in self.traces]))

    def folder(self, subject: Subject, method: str) -> Path:
        """Of a method's run on a scene."""
        return self.output / "scenes" / subject.name / method


def main(words: Sequence[str] | None = None) -> int:
    """Run it; the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--scene", action="append", default=[], metavar="NAME=FOLDER")
    parser.add_argument("--methods", default=",".join(METHODS))
    parser.add_argument("--traces", nargs="+", default=[str(DATA / "fox" / "trace.csv")])
    parser.add_argument(
        "--ablate",
        metavar="NAME=FOLDER",
        help="scene of the ablations, of 160 pixels unless told (default: the fox)",
    )
    parser.add_argument("--only", default=",".join(PARTS))
    parser.add_argument("--jobs", type=int, default=2, help="processes, each on one core (default: 2)")
    parser.add_argument("--quick", action="store_true")
    args = parser.parse_args(words)
    return run_command("reproduce", lambda: reproduce(_plan(args)))


def _plan(args: argparse.Namespace) -> Plan:
    subjects = [parse_subject(text) for text in args.scene] or [EMBEDDED]
    for option, chosen, known in (("--methods", args.methods, METHODS), ("--only", args.only, PARTS)):
        if unknown := set(chosen.split(",")) - set(known):
            raise ConfigError(f"{option}: expected {', '.join(known)}, got {', '.join(sorted(unknown))}")
    files = [f for path in map(Path, args.traces) for f in (sorted(path.iterdir()) if path.is_dir() else [path])]
    ablated = parse_subject(args.ablate) if args.ablate else EMBEDDED
    return Plan(
        output=args.output,
        subjects=tuple(s.quick() if args.quick else s for s in subjects),
        methods=tuple(args.methods.split(",")),
        traces=tuple(open_trace(file) for file in files),
        ablated=ablated.quick() if args.quick else replace(ablated, size=ablated.size or SIZE),
        parts=tuple(args.only.split(",")),
        quick=args.quick,
        jobs=args.jobs,
    )


def reproduce(plan: Plan) -> int:
    """All parts that are asked for, and the report of what there is."""
    plan.output.mkdir(parents=True, exist_ok=True)
    bar = Bar()
    jobs = [Job(s, m, plan.quick, plan.folder(s, m)) for s in plan.subjects for m in plan.methods]
    trained = train_all(jobs, plan.jobs, bar)
    bar.close()
    rows = [row_of(t) for t in trained]
    found: dict[str, list[dict[str, Any]]] = {"methods": as_table(rows)}
    if "stream" in plan.parts:
        found["streams"] = [row for s in plan.subjects for row in _streams(plan, s, trained)]
    if "prune" in plan.parts and OURS in plan.methods:
        found["pruning"] = [row for s in plan.subjects for row in _pruning(plan, s, trained)]
        found["overhead"] = [_overhead(plan, s, rows) for s in plan.subjects]
    if "ablate" in plan.parts:
        found["ablations"] = _ablations(plan)
    _report(plan, trained, found)
    return 0


def _streams(plan: Plan, subject: Subject, trained: Sequence[Trained]) -> list[dict[str, Any]]:
    """Every method's stream of a scene over all traces."""
    mine = [t for t in trained if t.scene == subject.name]
    key: dict[str, Any] = {"trained": [asdict(t) | {"fps": None} for t in mine]}
    key |= {"choosers": CHOOSERS, "traces": [[t.name, t.mean_bps] for t in plan.traces], "quick": plan.quick}

    def make() -> list[dict[str, Any]]:
        footage = subject.footage(plan.output)
        pictures, numbers = footage.pictures, range(footage.frames)
        streams: list[Stream] = []
        for t in mine:
            folder = plan.folder(subject, t.method)
            if t.method == OURS:
                levels = airgs_levels(open_package(folder / PACKAGE), pictures)
                streams += [Stream(OURS, chooser, levels) for chooser in CHOOSERS]
            else:
                shown = [read_ply(frame_path(folder, n)) for n in numbers]
                streams.append(Stream(t.method, "unpruned", (one_level(t.frames, shown, pictures),)))
        fps = float(subject.open().fps)
        return [{"scene": subject.name, **row} for row in stream_all(streams, plan.traces, 2 if plan.quick else 8, fps)]

    return list(plan.kept.get(f"streams-{subject.name}", key, make))


def _pruning(plan: Plan, subject: Subject, trained: Sequence[Trained]) -> list[dict[str, Any]]:
    """What pruning costs in our package of a scene."""
    ours = next(t for t in trained if (t.scene, t.method) == (subject.name, OURS))
    folder = plan.folder(subject, OURS)

    def make() -> list[dict[str, Any]]:
        package, original = open_package(folder / PACKAGE), open_sequence(folder / MODEL)
        pictures = subject.footage(plan.output).pictures
        rows = measure_pruning(package, original, pictures, plan.mean_rate)
        return [{"scene": subject.name, **row} for row in rows]

    key = {"rate": plan.mean_rate, "subject": subject.words(), "trained": asdict(ours) | {"fps": None}}
    return list(plan.kept.get(f"pruning-{subject.name}", key, make))


def _overhead(plan: Plan, subject: Subject, rows: Sequence[Row]) -> dict[str, Any]:
    ours = next(row for row in rows if row.scene == subject.name and row.method == OURS)
    package = open_package(plan.folder(subject, OURS) / PACKAGE)
    return {"scene": subject.name, **time_of_frame(package, ours, plan.mean_rate)}


def _ablations(plan: Plan) -> list[dict[str, Any]]:
    """Every change, some at a time; those that are kept are not run again."""
    base = _ablated_settings(plan)
    with ProcessPoolExecutor(
        plan.jobs, get_context("spawn"), prepare_worker, (os.getpid(), 1)
    ) as pool:  # one core each
        tasks = [pool.submit(_ablate, plan.kept, plan.ablated, base, plan.output, name) for name in names(base)]
        return [task.result() for task in tasks]


def _ablated_settings(plan: Plan) -> TrainSettings:
    settings = trainer_settings(plan.ablated, plan.quick)
    return settings if plan.quick else shortened(settings)


def _ablate(kept: KeptParts, subject: Subject, base: TrainSettings, output: Path, name: str) -> dict[str, Any]:
    at = names(base).index(name)
    key = {"subject": subject.words(), "settings": base.table(), "name": name}
    folder = output / "ablations" / f"{at:02d}"
    value = kept.get(f"ablation-{at:02d}", key, lambda: asdict(ablate(subject, base, folder, name)))
    return dict(value)


def _report(plan: Plan, trained: Sequence[Trained], found: Mapping[str, list[dict[str, Any]]]) -> None:
    for name, rows in found.items():
        write_csv(rows, plan.output / f"{name}.csv")
    write_json(plan.output / "results.json", {**machine(), "command": " ".join(sys.argv[1:]), **found})
    plot_quality(trained, plan.output / "quality.png")
    plot_sizes(found["methods"], plan.output / "sizes.png")
    tables = {"Quality, size and time": (found["methods"], METHOD_COLUMNS)}
    if "streams" in found:
        plot_times(found["streams"], plan.output / "times.png")
        tables["Streams, frame by frame"] = (found["streams"], STREAM_COLUMNS)
    if "pruning" in found:
        plot_pruning(found["pruning"], plan.output / "pruning.png")
        tables["Time of a frame"] = (found["overhead"], OVERHEAD_COLUMNS)
    if "ablations" in found:
        plot_ablations([Outcome(**row) for row in found["ablations"]], plan.output / "ablations.png")
        tables["Ablations"] = (found["ablations"], ABLATION_COLUMNS)
    tables["What the paper publishes"] = (published_table(), PUBLISHED_COLUMNS)
    write_page(tables, plan.output)
    write_markdown(tables, plan.output / "tables.md")
    print(f"{plan.output / 'index.html'}")


if __name__ == "__main__":
    sys.exit(main())
