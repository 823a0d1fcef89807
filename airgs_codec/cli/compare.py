"""airgs-manifest compare and rungs: two scenes or packages, or a package and its original."""

from __future__ import annotations

import json
from dataclasses import field
from pathlib import Path

from cyclopts.validators import Number

from airgs_codec._report import Table
from airgs_codec._settings import required, setting
from airgs_codec.cli.options import (
    FORMS,
    FRAMES_HELP,
    PACKAGE,
    BakingOptions,
    as_options,
    expect_folder,
    open_frames,
    parse_range,
)
from airgs_codec.cli.terminal import Bar, say
from airgs_codec.errors import ConfigError
from airgs_codec.inspect import compare as pictures
from airgs_codec.media.image import write_png
from airgs_codec.package.package import open_package
from airgs_codec.package.region import CHECKING, before_background, draw_views
from airgs_codec.places.whole import atomic_path
from airgs_codec.render import read_cameras
from airgs_codec.scene.camera import cameras_from, with_near_planes
from airgs_codec.scene.formats.table import clip_format

EVERY_HELP, VIEWS_HELP = "only every N-th of the frames", f"cameras to compare from{FORMS}"


@as_options
class Compare:
    a: str = required(f"the reference: a scene, or {PACKAGE}")
    b: str = required("what is compared with it, either as well")
    frames: str = setting(":", FRAMES_HELP, metavar="A:B", default="all that both have")
    every: int = setting(1, EVERY_HELP, validator=Number(gte=1))
    rung: str | None = setting(None, "keyframe quality and level of the package, of B where both are", default="Q0+L0")
    views: Path | None = setting(None, VIEWS_HELP, default="those of A, B or a package's region, or an orbit")
    output: Path | None = setting(None, "folder for the lowest picture: A, B, difference", alias="-o", metavar="DIR")
    json: bool = setting(False, "the same as JSON")
    baking: BakingOptions = field(default_factory=BakingOptions)


def compare(options: Compare) -> int:
    """Compare two scenes or packages: PSNR, SSIM, CIEDE2000, bytes, pictures."""
    folder = options.output
    if folder:
        expect_folder(folder)
    a, b = _open_both(options)
    numbers = range(*parse_range(options.frames, min(a.frames, b.frames)), options.every)
    given = cameras_from(a.origin, read_cameras(options.views)) if options.views else ()
    words, cameras = pictures.shared_views(a, b, pictures.compared_views(given), str(options.views))
    with Bar(options.json) as bar:
        result = pictures.compare_two(a, b, numbers, cameras, bar)
    written = []
    if folder:
        folder.mkdir(parents=True, exist_ok=True)
        written.append(str(folder / "lowest.png"))
        with atomic_path(folder / "lowest.png") as temporary:
            write_png(temporary, pictures.side_by_side(a, b, result.lowest))
    record, notes = pictures.comparison_json(a, b, result), pictures.left_out(a, b)
    if options.json:
        say(json.dumps(record | {"views": words, "left_out": notes, "pictures": written}))
    else:
        say(pictures.format_two(record, words, notes) + (f"\npictures: {', '.join(written)}" if written else ""))
    return 0


def _open_both(options: Compare) -> tuple[pictures.Side, pictures.Side]:
    baking, clips = vars(options.baking), [clip_format(Path(place)) for place in (options.a, options.b)]
    if any(baking.values()) and not any(clips):
        raise ConfigError(f"--bake-fps, --duration: expected a clip, got {options.a} and {options.b}")
    rungs = (None, options.rung) if pictures.is_package(options.b) else (options.rung, None)
    places = zip((options.a, options.b), rungs, clips, strict=True)
    sides = [pictures.open_side(place, rung, **(baking if clip else {})) for place, rung, clip in places]
    return pictures.comparable(*sides)


@as_options
class Rungs:
    package: str = required(PACKAGE)
    original: str = required("the sequence that it was made of")
    frames: str = setting(":", FRAMES_HELP, metavar="A:B", default="all")
    every: int = setting(1, EVERY_HELP, validator=Number(gte=1))
    views: Path | None = setting(None, VIEWS_HELP, default="drawn from the package's region")
    draws: int = setting(8, "views that are drawn", validator=Number(gte=1))
    json: bool = setting(False, "the same as JSON")
    baking: BakingOptions = field(default_factory=BakingOptions)


def rungs(options: Rungs) -> int:
    """Measure PSNR, SSIM and CIEDE2000 of every rung against the original."""
    package = open_package(options.package)
    original = open_frames(options.original, quiet=options.json, **vars(options.baking)).at_origin(package.origin)
    if len(original) != package.manifest.frames:
        raise ConfigError(f"{options.original}: expected {package.manifest.frames} frames, got {len(original)}")
    numbers = range(*parse_range(options.frames, len(original)), options.every)
    region, middle = package.manifest.region, original.load([len(original) // 2]).frames[0]
    given = cameras_from(package.origin, read_cameras(options.views)) if options.views else ()
    views = pictures.compared_views(given) or draw_views(region, options.draws, CHECKING)
    cameras = before_background(region, with_near_planes(views, middle))
    with Bar(options.json) as bar:
        rows = pictures.compare_rungs(package, original, numbers, cameras, bar)
    if options.json:
        say(json.dumps({"frames": list(numbers), "views": len(cameras), "rungs": rows}))
    else:
        say(f"{len(numbers)} frames in {len(cameras)} views; PSNR of the error pooled over pictures")
        say(Table("", rows, pictures.COMPARED_COLUMNS).to_text())
    return 0
