"""airgs-manifest: look into a package, check it."""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Sequence
from pathlib import Path

from airgs_codec._report import require_matplotlib
from airgs_codec.cli.common import Bar, run_command
from airgs_codec.decoder.decode import decode
from airgs_codec.errors import ConfigError
from airgs_codec.inspect.dense import dense_table, format_dense, measure_dense, plot_dense
from airgs_codec.inspect.errors import format_errors, measure_errors
from airgs_codec.inspect.inspection import bytes_by_attribute, format_attributes, format_summary, plot_ladder, summarise
from airgs_codec.inspect.validate import exceeded, validate
from airgs_codec.package.store import Package, open_package
from airgs_codec.render import read_cameras
from airgs_codec.scene.camera import measured_views, training_views
from airgs_codec.scene.orbits import orbit_views
from airgs_codec.scene.sequence import open_sequence


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="airgs-manifest", description="Look into a package, check it.")
    commands = parser.add_subparsers(dest="command", required=True)
    inspect = commands.add_parser("inspect", help="groups, tiers, levels, rungs, bytes, what was left out")
    inspect.add_argument("package", type=Path)
    inspect.add_argument("--json", action="store_true", help="the same as JSON")
    inspect.add_argument("--plot", type=Path, metavar="FILE.png", help="picture of the ladder and of bytes over time")
    inspect.add_argument("--ladder", action="store_true", help="measure the dense level space (minutes)")
    inspect.add_argument("--against", type=Path, metavar="SEQUENCE", help="the original, for --ladder (default: L0)")
    inspect.add_argument("--views", type=Path, metavar="FILE", help="cameras, for --ladder (default: generated)")
    check = commands.add_parser("validate", help="exit 0, or 1 with one line a finding")
    check.add_argument("package", type=Path)
    check.add_argument("--against", type=Path, metavar="SEQUENCE", help="the original: measure the errors again")
    check.add_argument("--json", action="store_true", help="findings as JSON")
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point; returns the exit status."""
    args = _parser().parse_args(argv)
    return run_command("airgs-manifest", lambda: _inspect(args) if args.command == "inspect" else _validate(args))


def _inspect(args: argparse.Namespace) -> int:
    if args.plot:
        require_matplotlib("--plot")
    package = open_package(args.package)
    m = package.manifest
    if args.ladder:
        return _ladder(package, args)
    if args.plot:
        plot_ladder(m, package.manifest_bytes, args.plot)
    if args.json:
        by_attribute = {name: round(size) for name, size in bytes_by_attribute(package).items()}
        print(json.dumps(summarise(m, package.manifest_bytes) | {"top_rung_bytes_by_attribute": by_attribute}))
    else:
        print(format_summary(m, package.manifest_bytes))
        print(format_attributes(package))
        if args.plot:
            print(f"picture: {args.plot}")
    return 0


def _ladder(package: Package, args: argparse.Namespace) -> int:
    original = open_sequence(args.against) if args.against else None
    if original is not None and len(original) != package.manifest.frames:
        raise ConfigError(f"{args.against}: expected {package.manifest.frames} frames, got {len(original)}")
    cameras = read_cameras(args.views) if args.views else list(original.cameras) if original else []
    cameras = cameras or orbit_views(decode(package, 0))
    training = training_views(cameras)
    bar = Bar(args.json)
    points = measure_dense(package, measured_views(cameras), training, original, os.cpu_count() or 1, bar)
    bar.close()
    if args.plot:
        plot_dense(points, package.manifest.frames, args.plot)
    print(json.dumps(dense_table(points)) if args.json else format_dense(points, package.manifest.frames))
    return 0


def _validate(args: argparse.Namespace) -> int:
    against = open_sequence(args.against) if args.against else None
    findings, measured = validate(args.package), []
    if not findings and against is not None:
        measured = list(measure_errors(open_package(args.package), against))
        findings = exceeded(measured)
    if args.json:
        print(json.dumps([{"reason": f.reason, "where": f.where, "detail": f.detail} for f in findings]))
    elif findings:
        print("\n".join(str(f) for f in findings))
    else:
        m = open_package(args.package).manifest
        print(f"valid: {m.frames} frames, {len(m.groups)} groups, {len(m.segments)} segments, {len(m.files)} files")
        if measured:
            print(format_errors(measured))
    return 1 if findings else 0
