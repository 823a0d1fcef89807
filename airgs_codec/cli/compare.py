"""airgs-manifest compare and rungs: two scenes or packages beside each other, or a package beside its original."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

from airgs_codec._settings import required, setting
from airgs_codec.cli.options import (
    FORMS,
    FRAMES,
    PACKAGE,
    BakingOptions,
    expect_folder,
    open_frames,
    parse_range,
    takes,
)
from airgs_codec.cli.terminal import Bar, say
from airgs_codec.errors import ConfigError
from airgs_codec.inspect.compare import (
    Comparison,
    Side,
    comparable,
    compare_rungs,
    compare_two,
    compared_views,
    comparison_json,
    format_rungs,
    format_two,
    is_package,
    left_out,
    open_side,
    shared_views,
    side_by_side,
)
from airgs_codec.media.image import write_png
from airgs_codec.package.package import open_package
from airgs_codec.package.region import CHECKING, before_background, draw_views
from airgs_codec.places.whole import atomic_path
from airgs_codec.render import read_cameras
from airgs_codec.scene.camera import cameras_from, with_near_planes
from airgs_codec.scene.formats.table import clip_format

EVERY, VIEWS = "only every N-th of the frames", "cameras to compare from"


@dataclass(frozen=True, kw_only=True)
class Compare(BakingOptions):
    a: str = required(f"the reference: a scene, or {PACKAGE}")
    b: str = required("what is compared with it, either as well")
    frames: str = setting(":", FRAMES, metavar="A:B", default="all that both have")
    every: int = setting(1, EVERY, least=1)
    rung: str | None = setting(None, "keyframe quality and level of the package, of B where both are", default="Q0+L0")
    views: Path | None = setting(None, f"{VIEWS}{FORMS}", default="those of A, B or a package's region, or an orbit")
    output: Path | None = setting(
        None, "write A, B and their difference in the worst picture: worst.png", alias="-o", metavar="DIR"
    )
    json: bool = setting(False, "the same as JSON")


@takes(Compare)
def compare(options: Compare) -> int:
    """Compare two scenes or packages: PSNR, SSIM, CIEDE2000, bytes, pictures."""
    if options.output:
        expect_folder(options.output)
    a, b = _open_both(options)
    numbers = range(*parse_range(options.frames, min(a.frames, b.frames)), options.every)
    given = cameras_from(a.origin, read_cameras(options.views)) if options.views else ()
    words, cameras = shared_views(a, b, compared_views(given), str(options.views))
    with Bar(options.json) as bar:
        result = compare_two(a, b, numbers, cameras, bar)
    written = _write_worst(options.output, a, b, result) if options.output else []
    notes = left_out(a, b)
    record = comparison_json(a, b, result)
    if options.json:
        more = {"views": words, "left_out": notes, "pictures": [str(path) for path in written]}
        say(json.dumps(record | more))
    else:
        say(format_two(record, words, notes))
        if written:
            say(f"pictures: {', '.join(map(str, written))}")
    return 0


def _open_both(options: Compare) -> tuple[Side, Side]:
    baking = options.baking()
    a_is_package, b_is_package = is_package(options.a), is_package(options.b)
    if options.rung is not None and not (a_is_package or b_is_package):
        raise ConfigError("--rung: expected a package, got two scenes")
    clips = [place for place in (options.a, options.b) if clip_format(Path(place))]
    if any(baking.values()) and not clips:
        raise ConfigError(f"--bake-fps, --duration: expected a clip, got {options.a} and {options.b}")
    a = open_side(options.a, None if b_is_package else options.rung, **(baking if options.a in clips else {}))
    b = open_side(options.b, options.rung if b_is_package else None, **(baking if options.b in clips else {}))
    return comparable(a, b)


def _write_worst(folder: Path, a: Side, b: Side, result: Comparison) -> list[Path]:
    picture = side_by_side(a, b, result.worst)
    folder.mkdir(parents=True, exist_ok=True)
    with atomic_path(folder / "worst.png") as temporary:
        write_png(temporary, picture)
    return [folder / "worst.png"]


@dataclass(frozen=True, kw_only=True)
class Rungs(BakingOptions):
    package: str = required(PACKAGE)
    original: str = required("the sequence that it was made of")
    frames: str = setting(":", FRAMES, metavar="A:B", default="all")
    every: int = setting(1, EVERY, least=1)
    views: Path | None = setting(None, f"{VIEWS}{FORMS}", default="drawn from the package's region")
    draws: int = setting(8, "views that are drawn", least=1)
    json: bool = setting(False, "the same as JSON")


@takes(Rungs)
def rungs(options: Rungs) -> int:
    """Measure PSNR, SSIM and CIEDE2000 of every rung against the original."""
    package = open_package(options.package)
    original = open_frames(options.original, quiet=options.json, **options.baking())
    original = original.at_origin(package.origin)
    if len(original) != package.manifest.frames:
        raise ConfigError(f"{options.original}: expected {package.manifest.frames} frames, got {len(original)}")
    numbers = range(*parse_range(options.frames, len(original)), options.every)
    region, middle = package.manifest.region, original.load([len(original) // 2]).frames[0]
    if options.views:
        views = compared_views(cameras_from(package.origin, read_cameras(options.views)))
    else:
        views = draw_views(region, options.draws, CHECKING)
    cameras = before_background(region, with_near_planes(views, middle))
    with Bar(options.json) as bar:
        rows = compare_rungs(package, original, numbers, cameras, bar)
    if options.json:
        say(json.dumps({"frames": list(numbers), "views": len(cameras), "rungs": rows}))
    else:
        say(f"{len(numbers)} frames in {len(cameras)} views; PSNR of the error pooled over pictures")
        say(format_rungs(rows))
    return 0
