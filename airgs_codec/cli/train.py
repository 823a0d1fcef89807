"""airgs-train: multi-view video to a tracked Gaussian sequence."""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from dataclasses import asdict, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from airgs_codec._report import require_matplotlib
from airgs_codec._settings import about
from airgs_codec.cli.common import Bar, add_device, expect_rate, fraction, parse_frames, run_command
from airgs_codec.cli.training import (
    default_model,
    default_settings,
    follow_training,
    pose_rig,
    require_torch,
    run_training,
)
from airgs_codec.cli.work import add_work, shared_by, told_work
from airgs_codec.errors import ConfigError
from airgs_codec.jobs.job import Record
from airgs_codec.jobs.report import NAME as JOBS_NAME
from airgs_codec.jobs.report import write_report as write_jobs
from airgs_codec.scene.camera import BLACK
from airgs_codec.train.data.multiview import MultiviewScene, with_held_out, with_near
from airgs_codec.train.data.readers import open_scene
from airgs_codec.train.settings import DELTAS, FIRST_A_VIEW, PRESETS, STATIC, Temporal, TrainSettings, preset

if TYPE_CHECKING:  # torch is imported when training begins
    from airgs_codec.train.pipeline import Run
    from airgs_codec.train.record import Model

DEFAULTS = TrainSettings()


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="airgs-train",
        description="Train a tracked Gaussian sequence from multi-view video, for airgs-encode.",
    )
    parser.add_argument(
        "scene",
        type=Path,
        help="folder with transforms.json, train_meta.json (Panoptic), image_white_undistortion/ (HiFi4G), COLMAP's "
        "sparse/ or poses_bounds.npy, and pictures or a video of each camera; or videos alone, whose cameras' poses "
        "COLMAP finds",
    )
    parser.add_argument("-o", "--output", type=Path, help="model folder (default: SCENE with .gaussians appended)")
    parser.add_argument("--resume", action="store_true", help="go on with the run in the model folder")
    parser.add_argument("--report", type=Path, metavar="DIR", help="write curves, pictures, error maps and a page")
    parser.add_argument("--json", action="store_true", help="print the record as JSON instead of a line a frame")
    add_device(parser, "where it runs")
    add_work(parser, "no model is written: the same command without --part does that")
    _add_pictures(parser.add_argument_group("pictures"))
    _add_rig(parser.add_argument_group("videos without poses"))
    _add_method(parser.add_argument_group("method"))
    return parser


def _add_pictures(group: argparse._ArgumentGroup) -> None:
    group.add_argument("--frames", metavar="A:B", help="train frames A to B - 1 (default: all)")
    group.add_argument("--fps", type=fraction, help="frames a second (default: what the scene says, else 30)")
    _add_setting(group, "--max-size", "max_size", int, "PX", "as they are")
    group.add_argument(
        "--hold-out",
        metavar="NAMES",
        help="cameras kept for testing, with commas; 'none' (default: the scene's own, else one in eight)",
    )
    group.add_argument(
        "--near",
        type=float,
        metavar="UNITS",
        help="hide Gaussians nearer to a camera than this many world units (default: the scene's, else 0.01)",
    )
    group.add_argument("--match-exposure", action="store_true", help=about(TrainSettings, "match_exposure"))
    _add_setting(group, "--reference", "reference", str, "CAMERA", "the average of all")
    _add_setting(group, "--background", "background", str, "COLOUR", "the scene's own, else black")
    group.add_argument("--foreground", action="store_true", help=about(TrainSettings, "foreground"))


def _add_rig(group: argparse._ArgumentGroup) -> None:
    group.add_argument(
        "--lenses", choices=("own", "shared"), default="own", help="whether cameras have one lens (default: their own)"
    )
    group.add_argument(
        "--pose-frame", type=int, default=0, metavar="N", help="frame that poses are found from (default: 0)"
    )


def _add_method(group: argparse._ArgumentGroup) -> None:
    group.add_argument(
        "--preset",
        choices=PRESETS,
        default=PRESETS[0],
        help="paper: the AirGS paper's method and constants, read literally",
    )
    group.add_argument("--deltas", choices=DELTAS, help=_help("deltas", "direct; mlp+residual on CUDA"))
    _add_setting(group, "--budget", "budget", int, "N")
    _add_setting(group, "--capacity", "capacity", int, "N", "1.5 times the budget")
    _add_setting(group, "--sh-degree", "sh_degree", int, "D")
    _add_setting(group, "--coarse", "coarse", float, "SHARE")
    _add_setting(group, "--ssim-weight", "ssim_weight", float, "SHARE")
    group.add_argument(
        "--temporal",
        type=float,
        metavar="W",
        help=f"weight of changes from frame to frame, in codec steps; 0: none (default: {Temporal().weight:g})",
    )
    _add_setting(group, "--min-psnr", "min_psnr_db", float, "DB")
    _add_setting(group, "--max-drop", "max_drop_db", float, "DB")
    _add_setting(group, "--max-growth", "max_growth", float, "SHARE")
    _add_setting(group, "--inflation", "inflation", float, "W")
    group.add_argument("--static", choices=STATIC, help=_help("static"))
    counts = (DEFAULTS.iterations_from_scratch(1), DEFAULTS.key_iterations, DEFAULTS.frame_iterations)
    group.add_argument(
        "--iterations",
        metavar="FIRST,KEY,FRAME",
        help="iterations of a first frame, a keyframe and any other frame "
        f"(default: {','.join(map(str, counts))}; of a first frame at least {FIRST_A_VIEW} for each view)",
    )
    _add_setting(group, "--iteration-views", "iteration_views", int, "N", "1; 4 on CUDA")
    _add_setting(group, "--group-frames", "group_frames", int, "N", "one chunk")
    _add_setting(group, "--seed", "seed", int, "N")


def _add_setting(
    group: argparse._ArgumentGroup, option: str, name: str, kind: type, metavar: str, default: str = ""
) -> None:
    group.add_argument(option, dest=name, type=kind, metavar=metavar, help=_help(name, default))


def _help(name: str, default: str = "") -> str:
    """Meaning and default of a setting; `default` in words where the field does not tell it."""
    value = getattr(DEFAULTS, name)
    default = default or (f"{value:g}" if isinstance(value, float) else str(value))
    return f"{about(TrainSettings, name)} (default: {default})"


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point; returns the exit status."""
    return run_command("airgs-train", lambda: _run(_parser().parse_args(argv)))


def _run(args: argparse.Namespace) -> int:
    require_torch()
    from airgs_codec.render.backend import open_renderer
    from airgs_codec.train.pipeline import open_run
    from airgs_codec.train.report import write_report

    if args.report:
        require_matplotlib("--report")
        if args.report.exists() and not args.report.is_dir():
            raise ConfigError(f"{args.report}: expected a folder for the report, got a file")
    elsewhere = args.executor and args.device == "cuda"  # the workers have it
    renderer = open_renderer("auto" if elsewhere else args.device)
    device = "cuda" if elsewhere else renderer.device
    settings = _settings(args, device)
    if settings.group_frames is None and (option := shared_by(args)):
        raise ConfigError(f"{option}: expected --group-frames, without which no frame is fitted before the last one")
    scene = _scene(args)
    if settings.background is None and scene.background != BLACK and not args.json:
        print(f"{args.scene}: its pictures are before a background of {','.join(f'{c:g}' for c in scene.background)}")
    folder = args.output or default_model(args.scene)
    if args.part:
        return _train_part(args, scene, settings, device)
    run = open_run(scene, folder, settings, resume=args.resume, device=device)
    jobs: Sequence[Record] = ()
    if shared_by(args):
        jobs = _train_in_jobs(args, run)
    else:
        run_training(run, quiet=args.json)
    model = run.model
    if args.report:
        write_report(model, run.capture.pictures.with_exposure(model.record.exposure), args.report, renderer, jobs)
    print(json.dumps(summary(model)) if args.json else as_words(model, args.report))
    return 0


def _train_in_jobs(args: argparse.Namespace, run: Run) -> list[Record]:
    """Train by jobs; gives who did which."""
    from airgs_codec.train.pipeline import train_in_jobs

    bar = Bar(args.json)
    try:
        with told_work(args, bar) as work:
            follow_training(run, train_in_jobs(run, work), bar, quiet=args.json)
            return work.records()
    finally:
        bar.close()


def _train_part(args: argparse.Namespace, scene: MultiviewScene, settings: TrainSettings, device: str) -> int:
    """Do the jobs, and write no model."""
    from airgs_codec.train.pipeline import train_part

    bar = Bar(args.json)
    try:
        with told_work(args, bar) as work:
            train_part(scene, settings, device, work)
            records = work.records()
    finally:
        bar.close()
    if args.report:
        args.report.mkdir(parents=True, exist_ok=True)
        write_jobs(args.report / JOBS_NAME, records)
    print(f"{args.work}: all jobs are done; the same command without --part writes the model")
    return 0


def _scene(args: argparse.Namespace) -> MultiviewScene:
    expect_rate("--fps", args.fps)
    if args.near is not None and not 0 < args.near < float("inf"):
        raise ConfigError(f"--near: expected a positive distance, got {args.near}")
    if args.pose_frame < 0:
        raise ConfigError(f"--pose-frame: expected a frame of at least 0, got {args.pose_frame}")
    pose_rig(args.scene, frame=args.pose_frame, shared_lens=args.lenses == "shared", quiet=args.json)
    scene = open_scene(args.scene, fps=args.fps, frames=parse_frames(args.frames))
    names = None if args.hold_out is None else [] if args.hold_out == "none" else args.hold_out.split(",")
    scene = with_held_out(scene, names)
    return scene if args.near is None else with_near(scene, args.near)


def _settings(args: argparse.Namespace, device: str) -> TrainSettings:
    settings = preset(args.preset, default_settings(device))
    names = {f.name for f in fields(TrainSettings)} - {"temporal"}
    given: dict[str, Any] = {name: v for name, v in vars(args).items() if name in names and v is not None}
    if args.budget is not None and args.capacity is None:
        given["capacity"] = args.budget * 3 // 2
    if args.temporal is not None:
        given["temporal"] = replace(settings.temporal, weight=args.temporal)
    if args.iterations is not None:
        given |= _iterations(args.iterations)
    return replace(settings, **given)


def _iterations(text: str) -> dict[str, int]:
    """Settings of FIRST,KEY,FRAME. Raises ConfigError."""
    names = ("first_iterations", "key_iterations", "frame_iterations")
    try:
        return dict(zip(names, [int(part) for part in text.split(",")], strict=True))
    except ValueError as error:
        raise ConfigError(f"--iterations: expected FIRST,KEY,FRAME, got {text!r}") from error


def summary(model: Model) -> dict[str, object]:
    """The record as JSON has it, and what it comes to: means over frames; PSNR as `psnr_definition` says."""
    from airgs_codec.train.fit.losses import PSNR_DEFINITION

    frames = model.record.frames
    held_out = [f.held_out_psnr for f in frames if f.held_out_psnr is not None]
    return {
        "model": str(model.folder),
        "frames": [asdict(f) for f in frames],
        "keyframes": model.record.keyframes(),
        "psnr_definition": PSNR_DEFINITION,
        "psnr": sum(f.psnr for f in frames) / len(frames),
        "held_out_psnr": sum(held_out) / len(held_out) if held_out else None,
        "held_out_worst": min(held_out) if held_out else None,
        "seconds": sum(f.seconds for f in frames),
        "warnings": model.record.warnings(),
    }


def as_words(model: Model, report: Path | None) -> str:
    """What the run comes to, in a line, and where the report is."""
    s = summary(model)
    held_out = (
        "" if s["held_out_psnr"] is None else f", held-out {s['held_out_psnr']:.2f} (worst {s['held_out_worst']:.2f})"
    )
    page = f"\nreport: {report / 'index.html'}" if report else ""
    count, groups = len(model.record.frames), len(model.record.keyframes())
    quality = f"{s['psnr']:.2f} dB (mean over views and frames){held_out}"
    return f"{model.folder}: {count} frames, {groups} groups, {quality}, {s['seconds']:.0f} s{page}"
