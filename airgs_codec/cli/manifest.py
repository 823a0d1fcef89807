"""airgs-manifest: look into a package, check it, compare it with the original, put it on a page."""

from __future__ import annotations

import argparse
import dataclasses
import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from airgs_codec._report import require_matplotlib
from airgs_codec.cli.baking import add_baking, told_baking
from airgs_codec.cli.common import PACKAGE, Bar, add_views, parse_range, run_command
from airgs_codec.cli.compare import add_compare, compare
from airgs_codec.cli.export import add_export, export
from airgs_codec.encoder.publish import merge
from airgs_codec.errors import ConfigError
from airgs_codec.inspect.attributes import bytes_by_attribute, format_attributes
from airgs_codec.inspect.compare import claimed_quality, compare_streams, format_comparison, pool_splits
from airgs_codec.inspect.errors import format_errors, measure_errors
from airgs_codec.inspect.plot import plot_ladder
from airgs_codec.inspect.sides import compared_views, region_views, rung_streams, splits_of
from airgs_codec.inspect.summary import summarise
from airgs_codec.inspect.text import format_summary
from airgs_codec.inspect.validate import exceeded, validate
from airgs_codec.media.metrics import Difference, Quality
from airgs_codec.package.manifest import Manifest
from airgs_codec.package.package import open_package
from airgs_codec.package.region import CHECKING, DECIDING, MEASURING, before_background
from airgs_codec.package.world import up_of
from airgs_codec.places.results import open_store
from airgs_codec.render import Camera, read_cameras
from airgs_codec.scene.camera import UP, orbit_views
from airgs_codec.scene.sequence import GaussianSequence, open_sequence


def _parser() -> argparse.ArgumentParser:
    description = "Look into a package, check it, compare it with the original, put it on a page."
    parser = argparse.ArgumentParser(prog="airgs-manifest", description=description)
    commands = parser.add_subparsers(dest="command", required=True)
    _add_inspect(commands.add_parser("inspect", help="groups, tiers, levels, rungs, bytes, what was left out"))
    _add_validate(commands.add_parser("validate", help="exit 0, or 1 with one line a finding"))
    add_compare(commands.add_parser("compare", help="two scenes or packages: PSNR, SSIM, CIEDE2000, bytes, pictures"))
    _add_rungs(commands.add_parser("rungs", help="PSNR, SSIM and CIEDE2000 of every rung against the original"))
    add_export(commands.add_parser("export-page", help="a folder for any static host: the player and packages"))
    _add_merge(commands.add_parser("merge", help="publish the package that runs of airgs-encode --part have made"))
    return parser


def _add_inspect(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("package", help=PACKAGE)
    parser.add_argument("--json", action="store_true", help="the same as JSON")
    parser.add_argument("--plot", type=Path, metavar="FILE.png", help="picture of the ladder and of bytes over time")


def _add_validate(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("package", help=PACKAGE)
    parser.add_argument("--against", metavar="SEQUENCE", help="the original: measure the errors again")
    add_baking(parser)
    parser.add_argument("--json", action="store_true", help="findings as JSON")


def _add_rungs(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("package", help=PACKAGE)
    parser.add_argument("original", help="the sequence that it was made of")
    add_baking(parser)
    parser.add_argument("--level", help="one level, L0, L1, … or its number (default: all)")
    parser.add_argument("--key-quality", help="one key quality, Q0, Q1, … or its number (default: all)")
    parser.add_argument("--frames", default=":", metavar="A:B", help="frames A to B - 1 (default: all)")
    parser.add_argument("--every", type=int, default=1, metavar="N", help="only every N-th of the frames (default: 1)")
    add_views(parser, "cameras to compare from", "the original's")
    parser.add_argument("--split", metavar="NAME", help="train, test or region alone (default: the last two, or all)")
    draws = "views drawn from the package's region: the split region (default: %(default)s)"
    parser.add_argument("--draws", type=int, default=8, metavar="N", help=draws)
    seed = f"of the draws (default: %(default)s; the encoder used {DECIDING} and {MEASURING})"
    parser.add_argument("--seed", type=int, default=CHECKING, help=seed)
    parser.add_argument("--json", action="store_true", help="the same as JSON")


def _add_merge(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("work", help="what was --work of the parts: a folder, or s3://, gs://, az:// and a prefix")
    parser.add_argument("-o", "--output", required=True, help=PACKAGE)


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point; returns the exit status."""
    args = _parser().parse_args(argv)
    work: dict[str, Callable[[argparse.Namespace], int]] = {
        "inspect": _inspect,
        "validate": _validate,
        "compare": compare,
        "rungs": _rungs,
        "export-page": export,
        "merge": _merge,
    }
    return run_command("airgs-manifest", lambda: work[args.command](args))


def _inspect(args: argparse.Namespace) -> int:
    if args.plot:
        require_matplotlib("--plot")
    package = open_package(args.package)
    summary = summarise(package.manifest, package.manifest_bytes)
    if args.plot:
        plot_ladder(package.manifest, package.manifest_bytes, args.plot)
    if args.json:
        by_attribute = {name: round(size) for name, size in bytes_by_attribute(package).items()}
        print(json.dumps(summary.to_json() | {"top_rung_bytes_by_attribute": by_attribute}))
    else:
        print(format_summary(summary))
        print(format_attributes(package))
        if args.plot:
            print(f"picture: {args.plot}")
    return 0


def _validate(args: argparse.Namespace) -> int:
    against = open_sequence(args.against, **told_baking(args)) if args.against else None
    findings, measured = validate(args.package), []
    if not findings and against is not None:
        measured = list(measure_errors(open_package(args.package), against))
        findings = exceeded(measured)
    if args.json:
        print(json.dumps([dataclasses.asdict(finding) for finding in findings]))
    elif findings:
        print("\n".join(str(f) for f in findings))
    else:
        m = open_package(args.package).manifest
        files = 2 + sum(1 for _ in m.files())
        print(f"valid: {m.frames} frames, {len(m.groups)} groups, {len(m.segments)} segments, {files} files")
        if measured:
            print(format_errors(measured))
    return 1 if findings else 0


def _rungs(args: argparse.Namespace) -> int:
    package, original = open_package(args.package), open_sequence(args.original, **told_baking(args))
    _expect_frames(args.original, len(original), package.manifest.frames)
    for name, least in (("every", 1), ("draws", 0), ("seed", 0)):
        if getattr(args, name) < least:
            raise ConfigError(f"--{name}: expected at least {least}, got {getattr(args, name)}")
    frames = range(*parse_range(args.frames, len(original)), args.every)
    cameras = list(read_cameras(args.views) if args.views else original.cameras)
    streams = rung_streams(package, frames, args.level, args.key_quality)
    claimed = claimed_quality(package.manifest, streams)
    region = package.manifest.region
    cameras += region_views(region, args.draws, args.seed)
    cameras = compared_views(cameras or _around(package.manifest, original), args.split)
    cameras = before_background(region, cameras)
    bar = Bar(args.json)
    looked_at = [(number, camera) for number in frames for camera in cameras]
    splits = pool_splits(compare_streams(streams, original, looked_at, Difference.of, bar), looked_at)
    bar.close()
    if args.json:
        quality = {"claimed": _plain(claimed), **{split: _plain(some) for split, some in splits.items()}}
        print(json.dumps({"frames": list(frames), "views": splits_of(cameras), "quality": quality}))
    else:
        views = ", ".join(f"{count} {split}" for split, count in splits_of(cameras).items())
        print(f"{len(frames)} frames; views: {views}; PSNR of the error pooled over pictures, and of the worst picture")
        print(format_comparison({"claimed": claimed, **splits}))
    return 0


def _merge(args: argparse.Namespace) -> int:
    manifest, size = merge(open_store(args.work), args.output)
    print(f"{format_summary(summarise(manifest, size))}\n\n{args.output}: {manifest.frames} frames")
    return 0


def _around(m: Manifest, original: GaussianSequence) -> list[Camera]:
    """Views on an orbit around the middle frame, upright as the package tells."""
    return orbit_views(original.read(len(original) // 2), up=UP if m.world is None else up_of(m.world))


def _plain(qualities: Mapping[str, Quality | None]) -> dict[str, Any]:
    return {name: quality and dataclasses.asdict(quality) for name, quality in qualities.items()}


def _expect_frames(path: str | Path, got: int, expected: int) -> None:
    if got != expected:
        raise ConfigError(f"{path}: expected {expected} frames, got {got}")
