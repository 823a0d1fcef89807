"""airgs-encode: a folder of .ply frames to a package."""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path

from airgs_codec.cli.common import Bar, run_command
from airgs_codec.cli.train import default_model, default_settings, pick_device, require_torch, run_training
from airgs_codec.encoder.publish import AuthorReport, author_package
from airgs_codec.encoder.quality import DEFAULT_FRAMES
from airgs_codec.encoder.rate_target import PSNR, SIZE, Goal
from airgs_codec.encoder.settings import DEFAULT_LEVELS, PAPER_LEVELS, QUALITY_FACTORS, RANKS, EncodeSettings
from airgs_codec.errors import ConfigError, SceneError
from airgs_codec.inspect.inspection import format_summary
from airgs_codec.media.h264 import DEFAULT_PRESET, PRESETS
from airgs_codec.scene.sequence import GaussianSequence, open_sequence
from airgs_codec.scene.usage import MEASURES
from airgs_codec.train.data.readers import is_multiview


def _parser() -> argparse.ArgumentParser:
    defaults = EncodeSettings()
    parser = argparse.ArgumentParser(
        prog="airgs-encode",
        description="Encode a Gaussian sequence (a folder of .ply frames) as H.264 pictures and a DASH manifest. "
        "Multi-view video is trained first, as airgs-train does by default.",
    )
    parser.add_argument(
        "scene",
        type=Path,
        help="folder of .ply frames, optionally sequence.json and transforms.json; or of multi-view pictures",
    )
    parser.add_argument("-o", "--output", type=Path, help="package folder (default: SCENE with .airgs appended)")
    _add_choices(parser)
    parser.add_argument(
        "--segment",
        type=float,
        default=defaults.segment_s,
        metavar="S",
        help="longest state segment, seconds (default: 1)",
    )
    parser.add_argument(
        "--group",
        type=int,
        default=defaults.group_frames,
        metavar="FRAMES",
        help="longest group without given keyframes (default: 30)",
    )
    parser.add_argument("--fps", type=Fraction, help="frames a second (default: sequence.json, else 30)")
    _add_measuring(parser)
    parser.add_argument(
        "--preset", choices=PRESETS, default=DEFAULT_PRESET, help=f"x264 preset (default: {DEFAULT_PRESET})"
    )
    parser.add_argument(
        "--jobs", type=int, default=defaults.jobs, help="representations encoded at a time (default: cores)"
    )
    parser.add_argument("--attribution", metavar="TEXT", help="who made the scene (default: SCENE/ATTRIBUTION.txt)")
    parser.add_argument("--json", action="store_true", help="print a JSON report instead of a table")
    return parser


def _add_choices(parser: argparse.ArgumentParser) -> None:
    goal = parser.add_mutually_exclusive_group()
    goal.add_argument(
        "--quality",
        choices=tuple(QUALITY_FACTORS),
        default="medium",
        help="a factor on every quantiser step: low 1.6, medium 1, high 0.6",
    )
    goal.add_argument("--target-psnr", type=float, metavar="DB", help="PSNR of the top rung, steps are searched for")
    goal.add_argument("--target-mb", type=float, metavar="MB", help="megabytes a frame of the top rung, all it fetches")
    goal.add_argument("--target-mbps", type=float, metavar="MBPS", help="mean megabits a second of the top rung")
    parser.add_argument(
        "--steps",
        choices=("calibrated", "default"),
        default="calibrated",
        help="calibrated: steps, levels and tiers from trial encodes of this scene, kept for the next time (default)",
    )
    parser.add_argument("--levels", metavar="LIST", help="PRUNED%%:STEP_FACTOR,… ascending, instead of calibrated ones")
    parser.add_argument("--ladder", choices=("paper",), help="instead of --levels; paper: 0..90 %% pruned, steps fixed")
    parser.add_argument("--keep-all", action="store_true", help="leave nothing out but what is constant")


def _add_measuring(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--views",
        type=Path,
        metavar="FILE",
        help="cameras that usage and quality are measured on (default: SCENE/transforms.json, else generated)",
    )
    parser.add_argument(
        "--usage",
        choices=MEASURES,
        default=EncodeSettings().usage,
        help="usage of a Gaussian, which ranks key tiers: max or sum of alpha T, pixel hits (the paper, literally), or "
        "importance: max x sum x the error of leaving it out (default: importance)",
    )
    parser.add_argument(
        "--rank",
        choices=RANKS,
        default=EncodeSettings().rank,
        help="what ranks updates for pruning: the expected error of withholding one, or usage x size of the change "
        "(default: error)",
    )
    parser.add_argument(
        "--measure-frames",
        type=int,
        default=DEFAULT_FRAMES,
        metavar="N",
        help=f"frames a segment on which every rung is rendered (default: {DEFAULT_FRAMES}; 0: do not measure)",
    )


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point; returns the exit status."""
    args = _parser().parse_args(argv)
    return run_command("airgs-encode", lambda: _run(args))


def parse_levels(text: str) -> tuple[tuple[float, float], ...]:
    """'0:1,30:1.5' -> ((0, 1), (0.3, 1.5)). Raises ConfigError."""
    try:
        pairs = [part.split(":") for part in text.split(",")]
        return tuple((float(pruned) / 100, float(factor)) for pruned, factor in pairs)
    except ValueError as error:
        raise ConfigError(f"--levels: expected PRUNED:FACTOR,…, got {text!r}") from error


def _run(args: argparse.Namespace) -> int:
    levels = parse_levels(args.levels) if args.levels else PAPER_LEVELS if args.ladder else DEFAULT_LEVELS
    if args.measure_frames < 0:
        raise ConfigError(f"--measure-frames: expected 0 or more, got {args.measure_frames}")
    settings = EncodeSettings(
        levels=levels,
        quality=QUALITY_FACTORS[args.quality],
        segment_s=args.segment,
        group_frames=args.group,
        usage=args.usage,
        rank=args.rank,
        keep_all=args.keep_all,
        preset=args.preset,
        jobs=args.jobs,
    )
    if args.fps is not None and not 0 < args.fps <= 1000:
        raise ConfigError(f"--fps: expected 0 < fps <= 1000, got {args.fps}")
    folder = _trained(args) if is_multiview(args.scene) else args.scene
    sequence = open_sequence(folder, views=args.views, fps=args.fps)
    scene = args.scene.resolve()  # "." has no name of its own
    target = args.output or scene.with_name(scene.name + ".airgs")
    bar = Bar(args.json)
    try:
        report = author_package(
            sequence,
            target,
            settings,
            calibrated=args.steps == "calibrated",
            ladder=not (args.levels or args.ladder),
            goal=_goal(args, sequence),
            attribution=_attribution(args),
            measure_frames=args.measure_frames,
            progress=bar,
        )
    finally:
        bar.close()
    print(json.dumps(_as_json(report, target)) if args.json else _as_words(report, target))
    return 0


def _trained(args: argparse.Namespace) -> Path:
    """The model of a multi-view scene, trained as far as it is not yet."""
    require_torch()
    from airgs_codec.train.data.multiview import with_held_out
    from airgs_codec.train.data.readers import open_scene

    folder = default_model(args.scene)
    scene = with_held_out(open_scene(args.scene, fps=args.fps), None)
    device = pick_device("auto")
    run_training(scene, folder, default_settings(device), resume=True, device=device, quiet=args.json)
    return folder


def _goal(args: argparse.Namespace, sequence: GaussianSequence) -> Goal | None:
    if args.target_psnr is not None:
        return Goal(PSNR, args.target_psnr)
    if args.target_mb is not None:
        return Goal(SIZE, 1e3 * args.target_mb)
    if args.target_mbps is not None:
        return Goal(SIZE, 1e3 / 8 * args.target_mbps / float(sequence.fps))
    return None


def _attribution(args: argparse.Namespace) -> str:
    file = args.scene / "ATTRIBUTION.txt"
    try:
        return args.attribution or (file.read_text(encoding="utf-8").strip() if file.is_file() else "")
    except (OSError, UnicodeDecodeError) as error:
        raise SceneError(f"{file}: expected UTF-8 text: {error}") from error


def _as_json(report: AuthorReport, target: Path) -> dict[str, object]:
    m = report.manifest
    return {
        "package": str(target),
        "frames": m.frames,
        "bytes": sum(f.bytes for f in m.files.values()) + report.manifest_bytes,
        "top_rung_bytes": m.bytes_of(m.rung_files(0, 0)) + report.manifest_bytes,
        "seconds": {name: round(value, 3) for name, value in _times(report).items()},
        "calibration_cached": report.cached,
        "repairs": m.repairs,
    }


def _as_words(report: AuthorReport, target: Path) -> str:
    m = report.manifest
    times = ", ".join(f"{name} {value:.1f} s" for name, value in _times(report).items() if value >= 0.05)
    kept = " (calibration kept from before)" if report.cached else ""
    return f"{format_summary(m, report.manifest_bytes)}\n\n{target}: {m.frames} frames; {times}{kept}"


def _times(report: AuthorReport) -> dict[str, float]:
    return {
        "training views": report.survey_s,
        "calibration": report.calibrate_s,
        "search": report.search_s,
        "encoding": report.encode_s,
        "measuring": report.measure_s,
    }
