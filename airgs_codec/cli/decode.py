"""airgs-decode: a package back to splat files: .ply frames, or any other format."""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator, Sequence

from airgs_codec.cli.common import PACKAGE, Bar, parse_range, run_command
from airgs_codec.decoder.decode import decode_frames
from airgs_codec.errors import ConfigError
from airgs_codec.package.package import Package, open_package
from airgs_codec.package.paths import JSON_NAME
from airgs_codec.package.region import background_of
from airgs_codec.package.world import misread
from airgs_codec.scene.formats.write import Numbered, Target, choose_target, format_keys, write_frames

_OUTPUT = "folder for the frames, 000000.ply and on; or a file whose ending says its format"


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="airgs-decode", description="Decode a package to .ply or other splat files.")
    parser.add_argument("package", help=PACKAGE)
    parser.add_argument("-o", "--output", required=True, help=_OUTPUT)
    words = "format of the files (default: that of the output's ending, or ply)"
    parser.add_argument("--format", choices=format_keys(), help=words)
    parser.add_argument("--level", default="L0", help="state level: L0, L1, … or its number (default: L0)")
    parser.add_argument("--key-quality", default="Q0", help="key quality: Q0, Q1, … or its number (default: Q0)")
    parser.add_argument("--frames", default=":", metavar="A:B", help="frames A to B - 1, or one frame (default: all)")
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
    target = choose_target(args.output, args.format, stop - start)
    _expect_outside(target)
    bar = Bar(args.json)
    try:
        frames = _decoded(package, (start, stop), (level, quality), bar)
        lost = write_frames(target, frames, m.fps, background_of(m.region))
    finally:
        bar.close()
    report = {"frames": [start, stop], "level": level, "key_quality": quality, "output": args.output}
    report |= {"format": target.form.key, "lost": lost}
    report |= {"notes": (notes := misread(m.world, target.form.name, target.form.axes))}
    words = f"{stop - start} frames of {quality} + {level} in {args.output}"
    print(json.dumps(report) if args.json else "\n".join([words, *lost, *notes]))
    return 0


def _expect_outside(target: Target) -> None:
    """Raise ConfigError when frames would lie among the files of a package."""
    folder = target.path if target.folder else target.path.parent
    if (folder / JSON_NAME).is_file():
        raise ConfigError(f"{target.path}: expected a place outside of packages, got one in the package {folder}")


def _decoded(package: Package, frames: tuple[int, int], rung: tuple[str, str], bar: Bar) -> Iterator[Numbered]:
    """Frames of a level and key quality with their numbers; each counts as done when the next is asked for."""
    for frame in decode_frames(package, *frames, level=rung[0], key_quality=rung[1]):
        yield frame.number, frame.gaussians
        bar("decoding", frame.number - frames[0] + 1, frames[1] - frames[0])
