"""airgs-train: multi-view video to a tracked Gaussian sequence."""

from __future__ import annotations

import argparse
import importlib.util
import json
from collections.abc import Sequence
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any

from airgs_codec._report import require_matplotlib
from airgs_codec.cli.common import Bar, run_command
from airgs_codec.errors import ConfigError

if TYPE_CHECKING:  # torch is imported when training begins
    from airgs_codec.train.record import FrameRecord, Model
    from airgs_codec.train.settings import TrainSettings


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="airgs-train",
        description="Train a tracked Gaussian sequence from multi-view video, for airgs-encode.",
    )
    parser.add_argument(
        "scene",
        type=Path,
        help="folder with transforms.json, train_meta.json (Panoptic), COLMAP's sparse/ or poses_bounds.npy, and "
        "pictures or a video of each camera",
    )
    parser.add_argument("-o", "--output", type=Path, help="model folder (default: SCENE with .gaussians appended)")
    parser.add_argument("--resume", action="store_true", help="go on with the run in the model folder")
    parser.add_argument("--report", type=Path, metavar="DIR", help="write curves, pictures, error maps and a page")
    parser.add_argument("--json", action="store_true", help="print the record as JSON instead of a line a frame")
    _add_input(parser)
    _add_method(parser)
    return parser


def _add_input(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group("pictures")
    group.add_argument("--frames", metavar="A:B", help="train frames A to B - 1 (default: all)")
    group.add_argument("--fps", type=Fraction, help="frames a second (default: what the scene says, else 30)")
    group.add_argument("--max-size", type=int, metavar="PX", help="shrink pictures to this longest side")
    group.add_argument(
        "--hold-out",
        metavar="NAMES",
        help="cameras kept for testing, with commas; 'none' (default: the scene's own, else one in eight)",
    )
    group.add_argument(
        "--match-exposure", action="store_true", help="find a gain and an offset a camera; for real cameras"
    )
    group.add_argument(
        "--near", type=float, metavar="UNITS", help="hide what is nearer to a camera (default: the scene's, else 0.01)"
    )
    group.add_argument("--foreground", action="store_true", help="train only what the scene's masks show")


def _add_method(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group("method (defaults in airgs_codec/train/settings.py)")
    group.add_argument(
        "--preset", choices=("default", "paper"), default="default", help="paper: its constants, literally"
    )
    group.add_argument(
        "--method",
        choices=("airgs", "naive3dgs", "v3"),
        help="naive3dgs: every frame on its own; v3: groups of fixed length (default: airgs)",
    )
    group.add_argument("--budget", type=int, metavar="N", help="Gaussians of the first frame (default: 8000)")
    group.add_argument(
        "--capacity", type=int, metavar="N", help="most Gaussians there may ever be (default: 1.5 x budget)"
    )
    group.add_argument("--sh-degree", type=int, metavar="D", help="0 to 3 (default: 1)")
    group.add_argument(
        "--deltas",
        choices=("direct", "mlp", "mlp+residual"),
        help="how frames move: each Gaussian on its own, six MLPs, or both (default: direct; mlp+residual on CUDA)",
    )
    group.add_argument(
        "--temporal", type=float, metavar="W", help="weight of change, in codec steps (default: 8e-4; 0: none)"
    )
    group.add_argument("--tau", type=float, metavar="DB", help="PSNR below which a frame starts a group (default: 30)")
    group.add_argument(
        "--drop", type=float, metavar="DB", help="loss against the group's first frame that does too (default: 5)"
    )
    group.add_argument("--added", type=float, metavar="SHARE", help="most that a keyframe adds (default: 0.15)")
    group.add_argument("--inflation", type=float, metavar="W", help="weight of added opacity (default: 1e-6)")
    group.add_argument("--group", type=int, metavar="FRAMES", help="length of groups of --method v3 (default: 20)")
    group.add_argument(
        "--iterations", metavar="FIRST,KEY,FRAME", help="of the first frame, keyframes, others (default: 2500,1500,300)"
    )
    group.add_argument(
        "--device", choices=("auto", "cpu", "cuda"), default="auto", help="(default: cuda where it runs)"
    )
    group.add_argument("--seed", type=int, help="of all random numbers (default: 0)")


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point; returns the exit status."""
    args = _parser().parse_args(argv)
    return run_command("airgs-train", lambda: _run(args))


def _run(args: argparse.Namespace) -> int:
    require_torch()
    from airgs_codec.train.data.multiview import Pictures, with_held_out, with_near
    from airgs_codec.train.data.readers import open_scene
    from airgs_codec.train.report import write_report

    if args.fps is not None and not 0 < args.fps <= 1000:
        raise ConfigError(f"--fps: expected 0 < fps <= 1000, got {args.fps}")
    if args.report:
        require_matplotlib("--report")
        if args.report.exists() and not args.report.is_dir():
            raise ConfigError(f"{args.report}: expected a folder for the report, got a file")
    device = pick_device(args.device)
    settings = _settings(args, device)
    scene = open_scene(args.scene, fps=args.fps, frames=parse_frames(args.frames))
    names = None if args.hold_out is None else [] if args.hold_out == "none" else args.hold_out.split(",")
    scene = with_held_out(scene, names)
    if args.near is not None:
        if not 0 < args.near < float("inf"):
            raise ConfigError(f"--near: expected a positive distance, got {args.near}")
        scene = with_near(scene, args.near)
    folder = args.output or default_model(args.scene)
    model = run_training(scene, folder, settings, args.resume, device, quiet=args.json)
    if args.report:
        write_report(model, Pictures(scene, settings.max_size, settings.foreground), args.report)
    print(json.dumps(summary(model)) if args.json else as_words(model, args.report))
    return 0


def require_torch() -> None:
    """Raises ConfigError where torch is not installed."""
    if importlib.util.find_spec("torch") is None:
        raise ConfigError("training needs torch: pip install 'airgs-codec[train]'")


def default_model(scene: Path) -> Path:
    """Where a scene's model goes unless told otherwise."""
    resolved = scene.resolve()  # "." has no name of its own
    return resolved.with_name(resolved.name + ".gaussians")


def run_training(scene: Any, folder: Path, settings: TrainSettings, resume: bool, device: str, *, quiet: bool) -> Model:
    """Train with a bar and a line a frame."""
    from airgs_codec.train.run import train

    bar = Bar(quiet)

    def finished(record: FrameRecord) -> None:
        bar.close()
        if not quiet:
            print(frame_line(record), flush=True)

    try:
        return train(scene, folder, settings, resume=resume, device=device, progress=bar, finished=finished)
    finally:
        bar.close()


def frame_line(r: FrameRecord) -> str:
    """One finished frame in words."""
    held_out = "" if r.held_out_psnr is None else f", held-out {r.held_out_psnr:.2f}"
    kind = {"first": "  first frame", "frame": "", "key": f"  keyframe, {r.added:+,} Gaussians"}[r.kind]
    if r.rejected_psnr is not None:
        kind += f" (in the old group {r.rejected_psnr:.2f} dB)"
    static = f", static {100 * sum(r.static.values()) / len(r.static):.0f} %" if r.static else ""
    return f"frame {r.frame:4d}  {r.psnr:.2f} dB{held_out}  {r.gaussians:,} Gaussians{static}  {r.seconds:.1f} s{kind}"


def summary(model: Model) -> dict[str, object]:
    """The record, and what it comes to."""
    frames = model.record.frames
    held_out = [f.held_out_psnr for f in frames if f.held_out_psnr is not None]
    return {
        "model": str(model.folder),
        "frames": [{name: getattr(f, name) for name in f.__dataclass_fields__} for f in frames],
        "keyframes": model.record.keyframes(),
        "psnr": sum(f.psnr for f in frames) / len(frames),
        "held_out_psnr": sum(held_out) / len(held_out) if held_out else None,
        "held_out_worst": min(held_out) if held_out else None,
        "seconds": sum(f.seconds for f in frames),
    }


def as_words(model: Model, report: Path | None) -> str:
    """What the run comes to."""
    s = summary(model)
    held_out = (
        "" if s["held_out_psnr"] is None else f", held-out {s['held_out_psnr']:.2f} (worst {s['held_out_worst']:.2f})"
    )
    page = f"\nreport: {report / 'index.html'}" if report else ""
    count, groups = len(model.record.frames), len(model.record.keyframes())
    return f"{model.folder}: {count} frames, {groups} groups, {s['psnr']:.2f} dB{held_out}, {s['seconds']:.0f} s{page}"


def pick_device(wanted: str) -> str:
    """cpu or cuda for auto, cpu or cuda. Raises ConfigError where cuda is wanted and cannot run."""
    if wanted == "cpu":
        return "cpu"
    from airgs_codec.render import cuda

    reason = cuda.missing()
    if wanted == "cuda" and reason:
        raise ConfigError(f"--device cuda: {reason}")
    return "cpu" if reason else "cuda"


def parse_frames(text: str | None) -> tuple[int, int | None]:
    """A:B, A:, :B or one number; None is all. Raises ConfigError."""
    if text is None:
        return 0, None
    head, colon, tail = text.partition(":")
    try:
        start = int(head) if head else 0
        return start, (int(tail) if tail else None) if colon else start + 1
    except ValueError as error:
        raise ConfigError(f"--frames: expected A:B, got {text!r}") from error


def default_settings(device: str) -> TrainSettings:
    """Settings without options."""
    from airgs_codec.train.settings import TrainSettings

    return TrainSettings(deltas="direct" if device == "cpu" else "mlp+residual")


def _settings(args: argparse.Namespace, device: str) -> TrainSettings:
    from airgs_codec.train.settings import preset

    settings = preset(args.preset, default_settings(device))
    names = (
        "method",
        "budget",
        "capacity",
        "sh_degree",
        "deltas",
        "tau",
        "drop",
        "added",
        "inflation",
        "group",
        "seed",
    )
    given: dict[str, Any] = {name: getattr(args, name) for name in names if getattr(args, name) is not None}
    if args.budget is not None and args.capacity is None:
        given["capacity"] = args.budget * 3 // 2
    if args.temporal is not None:
        given["temporal"] = replace(settings.temporal, weight=args.temporal)
    if args.iterations is not None:
        counts = _three(args.iterations)
        given |= dict(zip(("first_iterations", "key_iterations", "frame_iterations"), counts, strict=True))
    given |= {name: getattr(args, name) for name in ("max_size", "foreground", "match_exposure")}
    return replace(settings, **given)


def _three(text: str) -> list[int]:
    try:
        counts = [int(part) for part in text.split(",")]
    except ValueError:
        counts = []
    if len(counts) != 3:
        raise ConfigError(f"--iterations: expected FIRST,KEY,FRAME, got {text!r}")
    return counts
