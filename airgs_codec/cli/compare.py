"""airgs-manifest compare: two scenes or packages beside each other, in figures and pictures."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from airgs_codec.cli.baking import UNTOLD, add_baking, is_told, told_baking
from airgs_codec.cli.common import PACKAGE, Bar, add_views, parse_range
from airgs_codec.errors import ConfigError
from airgs_codec.inspect.compare import Comparison, compare_two, comparison_json, format_two, side_by_side
from airgs_codec.inspect.sides import (
    Side,
    before_both,
    compared_views,
    described,
    expect_same_rate,
    is_package,
    left_out,
    open_side,
    shared_views,
)
from airgs_codec.media.image import write_png
from airgs_codec.places.whole import atomic_path
from airgs_codec.render import Camera, read_cameras
from airgs_codec.scene.formats.table import is_clip


def add_compare(parser: argparse.ArgumentParser) -> None:
    """The arguments."""
    parser.add_argument("a", metavar="A", help=f"the reference: a scene, or {PACKAGE}")
    parser.add_argument("b", metavar="B", help="what is compared with it, either as well")
    parser.add_argument("--frames", default=":", metavar="A:B", help="frames A to B - 1 (default: all that both have)")
    parser.add_argument("--every", type=int, default=1, metavar="N", help="only every N-th of the frames (default: 1)")
    rung = "key quality and level of the package, of B where both are packages (default: Q0+L0, always for the other)"
    parser.add_argument("--rung", metavar="Q0+L0", help=rung)
    default = "those of A or B, or drawn from the viewing region of a package, or an orbit"
    add_views(parser, "cameras to compare from", default)
    add_baking(parser)
    pictures = "write pictures of A, B and their difference: worst.png and typical.png"
    parser.add_argument("-o", "--output", type=Path, metavar="DIR", help=pictures)
    parser.add_argument("--json", action="store_true", help="the same as JSON")


def compare(args: argparse.Namespace) -> int:
    """Run it. Raises AirgsError for what cannot be compared, before anything is written."""
    _expect_folder(args.output)
    if args.every < 1:
        raise ConfigError(f"--every: expected at least 1, got {args.every}")
    a, b = _open_both(args)
    frames = range(*parse_range(args.frames, min(a.frames, b.frames)), args.every)
    views, cameras = _views(a, b, args.views)
    bar = Bar(args.json)
    result = compare_two(a, b, frames, cameras, bar)
    bar.close()
    written = _write_pictures(args.output, a, b, result) if args.output else []
    notes = left_out(a, b)
    if args.json:
        more = {"views": views, "left_out": notes, "pictures": [str(path) for path in written]}
        print(json.dumps(comparison_json(a, b, result) | more))
    else:
        print(format_two(a, b, result, views, notes))
        if written:
            print(f"pictures: {', '.join(map(str, written))}")
    return 0


def _open_both(args: argparse.Namespace) -> tuple[Side, Side]:
    packages = [is_package(place) for place in (args.a, args.b)]
    if args.rung is not None and not any(packages):
        raise ConfigError("--rung: expected a package, got two scenes")
    baking = told_baking(args)
    baked = {place: baking for place in (args.a, args.b) if is_told(baking) and is_clip(Path(place))}
    if is_told(baking) and not baked:
        raise ConfigError(f"--bake-fps, --duration: expected a clip, got {args.a} and {args.b}")
    b = open_side(args.b, args.rung if packages[1] else None, **baked.get(args.b, UNTOLD))
    a = open_side(args.a, None if packages[1] else args.rung, **baked.get(args.a, UNTOLD))
    expect_same_rate(a, b)
    return a, b


def _views(a: Side, b: Side, path: Path | None) -> tuple[str, list[Camera]]:
    words, views = described(compared_views(read_cameras(path), None), str(path)) if path else shared_views(a, b)
    return words, before_both(a, b, views)


def _expect_folder(path: Path | None) -> None:
    """Raise ConfigError where something that is no folder is in the way, before the work begins."""
    for place in [path, *path.absolute().parents] if path else []:
        if place.exists() and not place.is_dir():
            raise ConfigError(f"{place}: expected a folder, got a file")


def _write_pictures(folder: Path, a: Side, b: Side, result: Comparison) -> list[Path]:
    pictures = {name: side_by_side(a, b, getattr(result, name)) for name in ("worst", "typical")}
    folder.mkdir(parents=True, exist_ok=True)
    for name, picture in pictures.items():
        with atomic_path(folder / f"{name}.png") as temporary:
            write_png(temporary, picture)
    return [folder / f"{name}.png" for name in pictures]
