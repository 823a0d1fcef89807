"""airgs-manifest: look into a package, check it."""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path

from airgs_codec.cli.common import run_command
from airgs_codec.inspection import bytes_by_attribute, format_attributes, format_summary, plot_ladder, summarise
from airgs_codec.package import open_package
from airgs_codec.validate import validate


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="airgs-manifest", description="Look into a package, check it.")
    commands = parser.add_subparsers(dest="command", required=True)
    inspect = commands.add_parser("inspect", help="groups, tiers, levels, rungs, bytes, what was left out")
    inspect.add_argument("package", type=Path)
    inspect.add_argument("--json", action="store_true", help="the same as JSON")
    inspect.add_argument("--plot", type=Path, metavar="FILE.png", help="picture of the ladder and of bytes over time")
    check = commands.add_parser("validate", help="exit 0, or 1 with one line a finding")
    check.add_argument("package", type=Path)
    check.add_argument("--json", action="store_true", help="findings as JSON")
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point; returns the exit status."""
    args = _parser().parse_args(argv)
    return run_command("airgs-manifest", lambda: _inspect(args) if args.command == "inspect" else _validate(args))


def _inspect(args: argparse.Namespace) -> int:
    package = open_package(args.package)
    m = package.manifest
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


def _validate(args: argparse.Namespace) -> int:
    findings = validate(args.package)
    if args.json:
        print(json.dumps([{"reason": f.reason, "where": f.where, "detail": f.detail} for f in findings]))
    elif findings:
        print("\n".join(str(f) for f in findings))
    else:
        m = open_package(args.package).manifest
        print(f"valid: {m.frames} frames, {len(m.groups)} groups, {len(m.segments)} segments, {len(m.files)} files")
    return 1 if findings else 0
