"""airgs-decode: a package back to splat files: .ply frames, or any other format."""

from __future__ import annotations

import json
from collections.abc import Iterator
from functools import partial

import numpy as np
from numpy.typing import NDArray

from airgs_codec._settings import required, setting
from airgs_codec.cli.options import FRAMES_HELP, PACKAGE, as_options, open_frames, parse_range, run_program
from airgs_codec.cli.terminal import Bar, say
from airgs_codec.decoder.decode import decode_frames
from airgs_codec.errors import ConfigError
from airgs_codec.inspect.errors import input_rows
from airgs_codec.package.layout import JSON_NAME
from airgs_codec.package.package import open_package
from airgs_codec.package.region import background_of, misread
from airgs_codec.places.whole import atomic_path
from airgs_codec.scene.formats.table import KEYS, Numbered, choose_target, write_frames

ROWS_NAME = "rows.npz"  # an array for each frame, named by its number


@as_options
class Decode:
    package: str = required(PACKAGE)
    output: str = required("folder for 000000.ply and on, or a file that ends in a format", alias="-o", metavar="PLACE")
    format: str | None = setting(None, "of the files", choices=KEYS, metavar="FORMAT", default="as PLACE ends, or ply")
    level: str = setting("L0", "delta level: L0, L1, … or its number")
    keyframe_quality: str = setting("Q0", "keyframe quality: Q0, Q1, … or its number")
    frames: str = setting(":", FRAMES_HELP, metavar="A:B", default="all")
    against: str | None = setting(None, f"the original: {ROWS_NAME} says which of its rows each is", metavar="SEQUENCE")
    json: bool = setting(False, "print figures as JSON")


def decode(options: Decode) -> int:
    """Decode a package to .ply or other splat files."""
    package = open_package(options.package)
    m = package.manifest
    level = m.levels[m.level_index(options.level)].id
    quality = m.qualities[m.quality_index(options.keyframe_quality)].id
    start, stop = parse_range(options.frames, m.frames)
    target = choose_target(options.output, options.format, stop - start)
    folder = target.path if target.folder else target.path.parent
    if (folder / JSON_NAME).is_file():
        raise ConfigError(f"{target.path}: expected a place outside of packages, got one in the package {folder}")
    rows: dict[str, NDArray[np.int32]] = {}
    if options.against:
        found = input_rows(package, open_frames(options.against, quiet=options.json), start, stop, level=level)
        rows = dict(zip(map(str, range(start, stop)), found, strict=True))
    with Bar(options.json) as bar:

        def decoded() -> Iterator[Numbered]:
            for frame in decode_frames(package, start, stop, level=level, keyframe_quality=quality):
                yield frame.number, frame.gaussians
                bar("decoding", frame.number - start + 1, stop - start)  # when the next one is asked for

        lost = write_frames(target, decoded(), m.fps, background_of(m.region), package.origin)
    if options.against:
        with atomic_path(folder / ROWS_NAME) as temporary, temporary.open("wb") as file:
            np.savez_compressed(file, allow_pickle=False, **rows)
    notes = misread(m.world, target.form.name, target.form.axes)
    report = {"frames": [start, stop], "level": level, "keyframe_quality": quality, "output": options.output}
    report |= {"format": target.form.key, "lost": lost, "notes": notes}
    words = f"{stop - start} frames of {quality} + {level} in {options.output}"
    say(json.dumps(report) if options.json else "\n".join([words, *lost, *notes]))
    return 0


main = partial(run_program, "airgs-decode", decode)
