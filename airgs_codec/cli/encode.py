"""airgs-encode: Gaussian frames, a file or a folder, or multi-view video, to a package."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path

from airgs_codec._settings import about
from airgs_codec.cli.baking import add_baking, is_told, told_baking
from airgs_codec.cli.common import Bar, add_views, expect_rate, fraction, run_command
from airgs_codec.cli.encoding import add_encoding, told_settings
from airgs_codec.cli.follow import frames_may_come, report_groups
from airgs_codec.cli.kernels import prepare
from airgs_codec.cli.training import train_by_default
from airgs_codec.cli.work import add_work, told_work
from airgs_codec.cli.world import add_world, with_signs
from airgs_codec.encoder.live import follow
from airgs_codec.encoder.publish import EncodeReport, encode, encode_part
from airgs_codec.encoder.search import PSNR, SIZE, Goal
from airgs_codec.encoder.settings import (
    EncodeSettings,
)
from airgs_codec.errors import ConfigError
from airgs_codec.inspect.contact_sheet import write_contact_sheet
from airgs_codec.inspect.summary import summarise
from airgs_codec.inspect.text import format_summary
from airgs_codec.jobs.report import write_report
from airgs_codec.package.region import place_view
from airgs_codec.package.tables import Region
from airgs_codec.places.place import is_address
from airgs_codec.scene.sequence import GaussianSequence, GrowingFolder, open_sequence, read_attribution
from airgs_codec.train.data.readers import is_multiview


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
    add_encoding(parser)
    add_work(parser, "nothing is published: airgs-manifest merge does that")
    parser.add_argument("--report", type=Path, metavar="FILE.html", help="write a page on who did which job, and when")
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Encode as the arguments say; returns the exit status."""
    args = _parser().parse_args(with_signs(sys.argv[1:] if argv is None else argv))
    return run_command("airgs-encode", lambda: _run(args))


def _run(args: argparse.Namespace) -> int:
    settings = told_settings(args)
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
    prepare()
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
    whole = ("target_psnr", "target_mb", "target_mbps", "contact_sheet", "bake_fps", "duration")
    for name in (*whole, "work", "part", "executor", "report"):
        if getattr(args, name) is not None:
            raise ConfigError(f"--{name.replace('_', '-')}: expected a sequence that is whole, got --follow")
    if args.jobs != 1:
        raise ConfigError("--jobs: expected a sequence that is whole, got --follow, whose groups come one by one")
    if is_address(args.scene):
        raise ConfigError(f"--follow: expected a folder of this machine, got {args.scene}")
    folder = GrowingFolder(args.scene, views=args.views, fps=args.fps)
    bar = Bar(args.json)
    more = frames_may_come(args.idle)
    prepare()
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
