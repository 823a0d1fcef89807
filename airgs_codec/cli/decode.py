"""airgs-decode: a package back to .ply frames."""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path

from airgs_codec._files import atomic_path
from airgs_codec.cli.common import PACKAGE, Bar, parse_range, run_command
from airgs_codec.decoder.decode import decode_frames
from airgs_codec.errors import ConfigError
from airgs_codec.package.store import open_package
from airgs_codec.scene.ply import write_ply


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="airgs-decode", description="Decode a package to INRIA .ply frames.")
    parser.add_argument("package", help=PACKAGE)
    parser.add_argument("-o", "--output", type=Path, required=True, help="folder for the frames, 000000.ply and on")
    parser.add_argument("--level", default="L0", help="state level: L0, L1, … or its number (default: L0)")
    parser.add_argument("--key-quality", default="Q0", help="key quality: Q0, Q1, … or its number (default: Q0)")
    parser.add_argument("--frames", default=":", metavar="A:B", help="frames A to B - 1 (default: all)")
    parser.add_argument("--json", action="store_true", help="print a JSON report instead of words")
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point; returns the exit status."""
    args = _parser().parse_args(argv)
    return run_command("airgs-decode", lambda: _run(args))


def _run(args: argparse.Namespace) -> int:
    package = open_package(args.package)
    m = package.manifest
    level, quality = m.levels[m.level_index(args.level)].id, m.qualities[m.quality_index(args.key_quality)].id
    start, stop = parse_range(args.frames, m.frames)
    if args.output.exists() and not args.output.is_dir():
        raise ConfigError(f"{args.output}: expected a folder, got a file")
    args.output.mkdir(parents=True, exist_ok=True)
    bar = Bar(args.json)
    for frame in decode_frames(package, start, stop, level=level, key_quality=quality):
        path = args.output / f"{frame.number:06d}.ply"
        with atomic_path(path) as temporary:
            write_ply(temporary, frame.gaussians)
        bar("decoding", frame.number - start + 1, stop - start)
    bar.close()
    report = {"frames": [start, stop], "level": level, "key_quality": quality, "output": str(args.output)}
    words = f"{stop - start} frames of {quality} + {level} in {args.output}"
    print(json.dumps(report) if args.json else words)
    return 0
