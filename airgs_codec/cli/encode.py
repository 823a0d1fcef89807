"""airgs-encode: Gaussian frames, a file or a folder, or multi-view video, to a package."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

from airgs_codec._settings import about
from airgs_codec._stores import is_address
from airgs_codec.analysis.rows import ROWS
from airgs_codec.cli.baking import add_baking, is_told, told_baking
from airgs_codec.cli.common import Bar, add_device, add_views, expect_rate, fraction, run_command
from airgs_codec.cli.follow import frames_may_come, report_groups
from airgs_codec.cli.training import train_by_default
from airgs_codec.cli.work import add_work, told_work
from airgs_codec.cli.world import add_world, told_world, with_signs
from airgs_codec.encoder.follow import follow
from airgs_codec.encoder.publish import EncodeReport, encode, encode_part
from airgs_codec.encoder.rate_target import PSNR, SIZE, Goal
from airgs_codec.encoder.settings import (
    DEFAULT_LEVELS,
    DEFAULT_SETTINGS,
    KEYS,
    QUALITY_FACTORS,
    UPDATE_RANKS,
    EncodeSettings,
    LevelSettings,
    as_in_paper,
    as_preview,
)
from airgs_codec.errors import ConfigError
from airgs_codec.inspect.contact_sheet import write_contact_sheet
from airgs_codec.inspect.summary import summarise
from airgs_codec.inspect.text import format_summary
from airgs_codec.jobs.report import write_report
from airgs_codec.media.h264 import PRESETS
from airgs_codec.package.parse import read_region
from airgs_codec.package.region import place_view
from airgs_codec.package.tables import Region
from airgs_codec.scene.growing import GrowingFolder
from airgs_codec.scene.sequence import GaussianSequence, open_sequence, read_attribution
from airgs_codec.scene.usage import MEASURES
from airgs_codec.train.data.readers import is_multiview

FIELDS = tuple(field.name for field in fields(EncodeSettings))
STEPS = ("calibrated", "default")


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="airgs-encode",
        description="Encode Gaussian frames, a folder of them or one file, as H.264 pictures and a DASH manifest. "
        "Multi-view video is trained first, as airgs-train does by default.",
    )
    parser.add_argument(
        "scene",
        help="a folder of frames (.ply, compressed .ply, .spz, SOG, .splat, glTF), optionally with sequence.json and "
        "cameras, or one such file; or a clip (.splatv, .4dgs, .splat4d, Spacetime Gaussians .ply); or a folder of "
        "multi-view pictures; frames and clips also at an address, s3://, gs:// or az://",
    )
    parser.add_argument(
        "-o",
        "--output",
        help="package folder, or s3://, gs://, az:// and a prefix (default: SCENE with .airgs appended)",
    )
    parser.add_argument("--fps", type=fraction, help="frames a second (default: what sequence.json says, else 30)")
    add_baking(parser)
    add_views(
        parser, "cameras that usage and quality are measured with", "those beside the frames, else cameras on an orbit"
    )
    where = parser.add_mutually_exclusive_group()
    where.add_argument(
        "--margin",
        type=float,
        metavar="UNITS",
        help=about(EncodeSettings, "margin"),
    )
    where.add_argument(
        "--region",
        type=Path,
        metavar="FILE",
        help=f"{about(EncodeSettings, 'region')}: JSON as `region` in airgs.json",
    )
    add_world(parser)
    parser.add_argument(
        "--contact-sheet", type=Path, metavar="FILE", help="write a PNG of the scene from every place of its region"
    )
    parser.add_argument("--attribution", metavar="TEXT", help="who made the scene (default: SCENE/ATTRIBUTION.txt)")
    parser.add_argument(
        "--follow",
        action="store_true",
        help="encode group by group while frames are still being written, and publish each group when it is whole; "
        "until standard input ends, where it is a pipe, else until no frame has come for --idle seconds",
    )
    parser.add_argument("--idle", type=float, default=30.0, metavar="SECONDS", help="see --follow (default: 30)")
    parser.add_argument("--json", action="store_true", help="print a JSON report instead of a table")
    _add_rate(parser)
    _add_ladder(parser)
    _add_coding(parser)
    add_work(parser)
    return parser


def _add_setting(group: argparse._ActionsContainer, option: str, name: str, **more: Any) -> None:
    """An option that is a field of EncodeSettings: its default and its help text are the field's."""
    default = getattr(DEFAULT_SETTINGS, name)
    words = f"{about(EncodeSettings, name)} (default: {default})"
    group.add_argument(option, dest=name, type=type(default), default=default, help=words, **more)


def _add_rate(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group("rate (one of these)").add_mutually_exclusive_group()
    group.add_argument(
        "--quality",
        choices=tuple(QUALITY_FACTORS),
        default="medium",
        help="factor on every quantiser step: low 1.6, medium 1, high 0.6 (default: medium)",
    )
    group.add_argument(
        "--target-psnr",
        type=float,
        metavar="DB",
        help="search for the factor at which the top rung has this PSNR, in dB",
    )
    group.add_argument(
        "--target-mb",
        type=float,
        metavar="MB",
        help="search for the factor at which all that a viewer of the top rung fetches takes so many megabytes a frame",
    )
    group.add_argument(
        "--target-mbps", type=float, metavar="MBPS", help="the same in megabits a second of playback, on average"
    )


def _add_ladder(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group("ladder")
    group.add_argument(
        "--steps",
        choices=STEPS,
        default="calibrated",
        help="calibrated: quantiser steps, levels and tiers from trial encodes of this scene, kept for the next time; "
        "default: the same for every scene (default: calibrated)",
    )
    levels = group.add_mutually_exclusive_group()
    levels.add_argument(
        "--levels",
        metavar="LIST",
        help="PRUNED:FACTOR,... for each level the percentage of the updates withheld, ascending, and a factor on the "
        "steps, instead of calibrated ones",
    )
    levels.add_argument(
        "--ladder",
        choices=("paper",),
        help="paper: eleven levels, 0 to 100 %% of the updates pruned by usage frequency alone, equal steps, one key",
    )
    _add_setting(group, "--usage", "usage", choices=MEASURES)
    _add_setting(group, "--rank", "update_rank", choices=UPDATE_RANKS)
    group.add_argument("--keep-all", action="store_true", help=about(EncodeSettings, "keep_all"))


def _add_coding(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group("coding")
    _add_setting(group, "--segment", "segment_s", metavar="S")
    words = about(EncodeSettings, "group_frames")
    group.add_argument("--group", dest="group_frames", type=_group, default=None, metavar="auto|FRAMES", help=words)
    _add_setting(group, "--rows", "rows", choices=ROWS)
    _add_setting(group, "--keys", "keys", choices=KEYS)
    group.add_argument(
        "--quick",
        action="store_true",
        help="for a first look: no trial encodes, fast H.264, groups of 30 frames, few pictures measured",
    )
    _add_setting(group, "--measure-pictures", "measure_pictures", metavar="N")
    _add_setting(group, "--preset", "preset", choices=PRESETS)
    group.add_argument(
        "--threads", type=int, metavar="N", help=f"{about(EncodeSettings, 'threads')} (shared by --jobs)"
    )
    add_device(group, "where multi-view video is trained, and pictures that decide and measure are drawn")


def _group(text: str) -> int | None:
    """Frames of a group; None stands for auto."""
    if text != "auto" and not text.isdecimal():
        raise argparse.ArgumentTypeError(f"expected auto or a number of frames, got {text!r}")
    return None if text == "auto" else int(text)


def main(argv: Sequence[str] | None = None) -> int:
    """Encode as the arguments say; returns the exit status."""
    args = _parser().parse_args(with_signs(sys.argv[1:] if argv is None else argv))
    return run_command("airgs-encode", lambda: _run(args))


def parse_levels(text: str) -> tuple[LevelSettings, ...]:
    """Levels from text: '0:1,30:1.5' has a second one with 30 % withheld and steps times 1.5. Raises ConfigError."""
    try:
        pairs = [part.split(":") for part in text.split(",")]
        return tuple(LevelSettings(float(pruned) / 100, float(factor)) for pruned, factor in pairs)
    except ValueError as error:
        raise ConfigError(f"--levels: expected PRUNED:FACTOR,…, got {text!r}") from error


def _settings(args: argparse.Namespace) -> EncodeSettings:
    """Raises ConfigError for options that cannot work, SceneError or FormatError for a region that cannot be read."""
    chosen = parse_levels(args.levels) if args.levels else None
    calibrate = "none" if args.steps == "default" else "steps" if chosen else "ladder"
    region = read_region(args.region) if args.region else None
    known = ("quality", "steps", "levels", "region", "world", "threads")
    same = {name: getattr(args, name) for name in FIELDS if name in args and name not in known}
    settings = EncodeSettings(
        quality=QUALITY_FACTORS[args.quality],
        calibrate=calibrate,
        levels=chosen or DEFAULT_LEVELS,
        region=region,
        world=told_world(args),
        threads=args.threads or max(1, DEFAULT_SETTINGS.threads // max(1, args.jobs)),
        **same,
    )
    settings = as_in_paper(settings) if args.ladder else settings
    return as_preview(settings) if args.quick else settings


def _run(args: argparse.Namespace) -> int:
    settings = _settings(args)
    expect_rate("--fps", args.fps)
    target: str = args.output or _default_target(args.scene)
    if args.follow:
        return _follow(args, settings, target)
    sequence, credit = _open(args)
    if sequence.clip and not args.json:
        print(f"clip: {args.scene}: {sequence.clip.note}", flush=True)
    goal, attribution = _goal(args, sequence), args.attribution or credit
    cameras = sequence.files.name_of(sequence.cameras_path) if sequence.cameras_path else None
    if cameras and not args.json:
        print(f"cameras: {cameras}, {_counts(sequence)}", flush=True)
    bar = Bar(args.json)
    try:
        with told_work(args, bar) as work:
            if args.part:
                report = encode_part(sequence, settings, work, goal=goal, attribution=attribution)
            else:
                report = encode(sequence, target, settings, goal=goal, attribution=attribution, work=work)
    finally:
        bar.close()
    if args.report:
        write_report(args.report, report.records)
    if args.contact_sheet:
        _draw_places(args.contact_sheet, sequence, report.manifest.region)
    if args.part:
        print(f"{args.work}: all jobs are done; airgs-manifest merge {args.work} -o {target} publishes the package")
        return 0
    print(json.dumps(_as_json(report, target) | {"cameras": cameras}) if args.json else _as_words(report, target))
    return 0


def _default_target(scene: str) -> str:
    """Beside the scene."""
    place = scene.rstrip("/") if is_address(scene) else Path(scene).resolve()  # "." has no name of its own
    return f"{place}.airgs"


def _open(args: argparse.Namespace) -> tuple[GaussianSequence, str]:
    """The sequence that is encoded, trained where pictures were given, and who made the scene."""
    baking, folder = told_baking(args), Path(args.scene)
    if is_address(args.scene) or not is_multiview(folder):
        sequence = open_sequence(args.scene, views=args.views, fps=args.fps, **baking)
        return sequence, sequence.attribution
    if is_told(baking):
        raise ConfigError(f"{args.scene}: expected a clip for --bake-fps or --duration, got multi-view pictures")
    trained = train_by_default(folder, args.fps, args.device, quiet=args.json)
    return open_sequence(trained, views=args.views, fps=args.fps), read_attribution(folder)


def _follow(args: argparse.Namespace, settings: EncodeSettings, target: str) -> int:
    """Encode a sequence that somebody still writes."""
    for name in ("target_psnr", "target_mb", "target_mbps", "contact_sheet", "bake_fps", "duration"):
        if getattr(args, name) is not None:
            raise ConfigError(f"--{name.replace('_', '-')}: expected a sequence that is whole, got --follow")
    if is_address(args.scene):
        raise ConfigError(f"--follow: expected a folder of this machine, got {args.scene}")
    folder = GrowingFolder(args.scene, views=args.views, fps=args.fps)
    bar = Bar(args.json)
    more = frames_may_come(args.idle)
    try:
        groups = follow(folder, target, settings, more=more, attribution=args.attribution, progress=bar)
        report_groups(groups, target, args.json)
    finally:
        bar.close()
    return 0


def _draw_places(path: Path, sequence: GaussianSequence, region: Region) -> None:
    """A picture of the middle frame from every place of the region."""
    views = [place_view(region, place, f"place {i}") for i, place in enumerate(region.places)]
    write_contact_sheet(path, sequence.read(len(sequence) // 2), views)


def _counts(sequence: GaussianSequence) -> str:
    """How many cameras were taken, in words."""
    held_out = sum(camera.held_out for camera in sequence.cameras)
    return f"{len(sequence.cameras)} of them, {held_out} held out"


def _goal(args: argparse.Namespace, sequence: GaussianSequence) -> Goal | None:
    if args.target_psnr is not None:
        return Goal(PSNR, args.target_psnr)
    if args.target_mb is not None:
        return Goal(SIZE, 1e3 * args.target_mb)
    if args.target_mbps is not None:
        return Goal(SIZE, 1e3 / 8 * args.target_mbps / float(sequence.fps))
    return None


def _as_json(report: EncodeReport, target: str) -> dict[str, object]:
    m, rows = report.manifest, report.rows
    return {
        "package": target,
        "frames": m.frames,
        "bytes": m.bytes_of([path for g in range(len(m.groups)) for path in m.group_files(g)])
        + m.init.bytes
        + report.manifest_bytes,
        "top_rung_bytes": m.bytes_of(m.rung_files(0, 0)) + report.manifest_bytes,
        "seconds": {name: round(value, 3) for name, value in _times(report).items()},
        "calibration_cached": report.cached,
        "rows": {"matched": rows.matched, "sure": rows.sure, "unmatched": rows.unmatched, "alone": rows.alone},
        "repairs": [line for group in m.groups for line in group.repairs],
    }


def _as_words(report: EncodeReport, target: str) -> str:
    m = report.manifest
    times = ", ".join(f"{name} {value:.1f} s" for name, value in _times(report).items() if value >= 0.05)
    kept = " (calibration kept from before)" if report.cached else ""
    return f"{format_summary(summarise(m, report.manifest_bytes))}\n\n{target}: {m.frames} frames; {times}{kept}"


def _times(report: EncodeReport) -> dict[str, float]:
    return {
        "order of rows": report.rows_s,
        "training views": report.survey_s,
        "calibration": report.calibrate_s,
        "search": report.search_s,
        "encoding": report.encode_s,
        "measuring": report.measure_s,
    }
