"""The formats of files with Gaussians: which of them a file is of, the files of a scene, and frames to files of any.

To add a format, write its module, which ends in its `Format`, and list it here.
"""

from __future__ import annotations

import os
import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from airgs_codec._arguments import path_argument
from airgs_codec.errors import ConfigError, SceneError
from airgs_codec.places.whole import atomic_path, staged_files
from airgs_codec.scene.beside import DEFAULT_FPS, SETTINGS_NAME, Settings, write_settings
from airgs_codec.scene.camera import BLACK, Background
from airgs_codec.scene.files import expecting, require
from airgs_codec.scene.formats.clips import FOUR_DGS, SPACETIME_PLY, SPLAT4D, SPLATV, as_gaussians
from airgs_codec.scene.formats.form import ClipFormat, FrameFormat, FrameHeader, Losses
from airgs_codec.scene.formats.gltf import GLTF
from airgs_codec.scene.formats.packed import COMPRESSED, SPLAT, SPZ
from airgs_codec.scene.formats.ply import INRIA, read_header
from airgs_codec.scene.formats.sog import META_NAME, SOG, is_sog_folder, write_sog_folder
from airgs_codec.scene.frames import ZERO, Origin, choose_origin, in_world, narrowed
from airgs_codec.scene.gaussians import Gaussians

FRAMES = (INRIA, COMPRESSED, SPZ, SOG, SPLAT, GLTF)
CLIPS = (SPLATV, FOUR_DGS, SPLAT4D, SPACETIME_PLY)
FRAME_SUFFIXES = tuple(dict.fromkeys(suffix for form in FRAMES for suffix in form.suffixes))
CLIP_SUFFIXES = tuple(suffix for form in CLIPS for suffix in form.suffixes if suffix not in FRAME_SUFFIXES)
POINT_CLOUD, ITERATION = "point_cloud", "iteration_*/point_cloud.ply"  # of an INRIA model: the second in the first
LEVELS = "lod-meta.json"  # of a scene whose folders are pieces of it in levels of detail
INPUT = "input.ply"  # the points that such a model began with
SOG_FOLDER = replace(SOG, name="SOG folder", key="sog-folder", write=write_sog_folder)
KEYS = tuple(form.key for form in FRAMES)  # the names of formats that can be asked for
Numbered = tuple[int, Gaussians]  # a frame and its number


def clip_format(path: Path) -> ClipFormat | None:
    """Return the format of a file that is a clip; None for a frame, a folder or none. Raises SceneError."""
    form = _find_format(path) if path.is_file() else None
    return form if isinstance(form, ClipFormat) else None


def format_of(path: Path) -> FrameFormat:
    """Return the format of a file or folder that is a frame. Raises SceneError when it is none of the table's."""
    form = _find_format(path)
    if isinstance(form, ClipFormat):
        raise SceneError(f"{path}: expected one frame, got {form.name}, which holds many: give it by its own name")
    if form is None:
        known = ", ".join((*FRAME_SUFFIXES, *CLIP_SUFFIXES))
        raise SceneError(f"{path}: expected one of {known}, got {path.suffix or 'no suffix'}")
    return form


def _find_format(path: Path) -> FrameFormat | ClipFormat | None:
    """Return the format by the name of a file and, of a .ply, its header; None for a name that no format has."""
    if path.is_dir():
        return SOG
    named = [form for form in (*FRAMES, *CLIPS) if path.suffix.lower() in form.suffixes]
    if len(named) < 2:
        return named[0] if named else None
    vertex = read_header(path).elements.get("vertex")
    signed = [form for form in named if vertex and any(sign in vertex.properties for sign in form.signs)]
    return next(iter(signed), next(form for form in named if not form.signs))


def read_frame_header(path: Path) -> FrameHeader:
    """Return count and SH degree of a frame of any format, without its rows. Raises SceneError."""
    form = format_of(path)
    with expecting(path, form.name):
        return form.read_header(path)


def read_frame(path: Path) -> Gaussians:
    """Read a frame of any format as its file has it, positions in float64 where that has such. Raises SceneError."""
    form = format_of(path)
    with expecting(path, form.name):
        return form.read(path)


def read(path: str | Path) -> Gaussians:
    """Read one frame from a file or folder of any format that holds one, as it is stored.

    Raises SceneError for a broken one, one of no format or of many frames, and positions that float32 cannot hold.
    """
    _, paths, _ = find_frames(Path(path_argument("path", path)))
    require(len(paths) == 1, path, f"expected one frame, got {len(paths)}")
    g = read_frame(paths[0])
    if g.means.dtype != np.float32 and choose_origin(g) != ZERO:
        raise SceneError(f"{path}: expected positions near zero, got some that float32 cannot hold: open_sequence can")
    return narrowed(g, np.zeros(3), paths[0])


def is_frame(path: Path) -> bool:
    """Return whether a name is that of a frame, or a folder is one (SOG). Hidden files such as ._1.ply are none."""
    if path.name.startswith("."):
        return False
    return is_sog_folder(path) if path.is_dir() else path.suffix.lower() in FRAME_SUFFIXES


def find_frames(place: Path) -> tuple[Path, tuple[Path, ...], bool]:
    """Find the frames at a path: a file, a folder of frames, an INRIA model, a SOG folder or its meta.json.

    Returns the folder that cameras are looked for in, frames in display order, and whether one file was named itself.
    Frames of a folder have one suffix; where some are .ply, other files are ignored. Raises SceneError.
    """
    if place.name == META_NAME and is_sog_folder(place.parent):
        place = place.parent
    if place.is_file() or is_sog_folder(place):
        return place.parent, (place,), True
    require(place.is_dir(), place, "expected a folder of frames or a file, got nothing")
    if (place / LEVELS).exists():
        raise SceneError(f"{place}: expected frames, got levels of detail ({LEVELS}): splat-transform converts them")
    paths = sorted(filter(is_frame, place.iterdir()), key=lambda path: (natural_key(path), path.name))
    paths = [path for path in paths if path.suffix.lower() in INRIA.suffixes] or paths
    models = [*place.glob(f"{POINT_CLOUD}/{ITERATION}"), *place.glob(ITERATION)]
    if models and {path.name for path in paths} <= {INPUT}:
        newest = max(models, key=lambda path: natural_key(path.parent))
        return newest.parent, (newest,), False
    if not paths:
        if clip := next((path for path in sorted(place.iterdir()) if path.suffix.lower() in CLIP_SUFFIXES), None):
            raise SceneError(f"{place}: expected frames, got a clip: give {clip} by its own name")
        raise SceneError(f"{place}: expected at least one .ply frame, or one of another format, got none")
    if len(suffixes := sorted({"folders" if path.is_dir() else path.suffix.lower() for path in paths})) > 1:
        raise SceneError(f"{place}: expected frames of one format, got {', '.join(suffixes)}")
    return place, tuple(paths), False


def has_frames(folder: Path, *, apart_from: Collection[str]) -> bool:
    """Return whether frames of some format lie in a folder, or it is one; files of some names do not count."""
    frames = (path for path in folder.iterdir() if is_frame(path) and path.suffix != ".zip")  # that is of a data set
    return is_sog_folder(folder) or any(path.name not in apart_from for path in frames)


def natural_key(path: Path) -> list[tuple[int, str]]:
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in re.split(r"(\d+)", path.stem) if part]


def gap_notes(paths: Sequence[Path]) -> list[str]:
    """Return a sentence on numbers that are missing in the names of frames, none where they follow one another."""
    numbers = [int(found[-1]) for path in paths if (found := re.findall(r"\d+", path.stem))]
    if not (gaps := [(a, b) for a, b in pairwise(numbers) if b > a + 1]):
        return []
    count, (before, after) = sum(b - a - 1 for a, b in gaps), gaps[0]
    missing = f"{count} number{'s are' if count > 1 else ' is'} missing in the names of frames"
    return [f"{missing}, the first between {before} and {after}: frames are taken as consecutive"]


@dataclass(frozen=True, slots=True)
class Target:
    """A place for frames: a file, a folder of files 000000.spz and on, or one frame that is a folder."""

    path: Path
    form: FrameFormat
    folder: bool

    @property
    def many(self) -> bool:
        """Return whether each of any number of frames gets a file of its own."""
        return self.folder and self.form is not SOG_FOLDER


def without_ending(place: str) -> str:
    """Return the name of a file without the ending of its format, such as .compressed.ply; others as they are."""
    endings = (*(f".{form.key}" for form in FRAMES), *FRAME_SUFFIXES, *CLIP_SUFFIXES)
    found = max((ending for ending in endings if place.lower().endswith(ending)), key=len, default="")
    return place[: len(place) - len(found)]


def choose_target(place: str, key: str | None, frames: int) -> Target:
    """Return where frames go, by the format's name or the ending of a place.

    A name without an ending is a folder of frames; so is what ends in a slash or exists as a folder. Raises ConfigError
    for the ending of another format or of none, and a place that does not suit the number of frames or is in the way.
    """
    if not place:
        raise ConfigError("expected the name of a file or folder for the frames, got an empty one")
    path = Path(place)
    named = next((form for form in FRAMES if form.key == key), None)
    endings = [form for form in FRAMES if path.name.lower().endswith(f".{form.key}")]
    ending = max(endings, key=lambda form: len(form.key), default=None)
    if path.name == META_NAME and named in (None, SOG):
        target = Target(path.parent, SOG_FOLDER, True)
    elif ending is None and path.suffix and not place.endswith(os.sep) and not path.is_dir():
        known = ", ".join(f".{form.key}" for form in FRAMES)
        raise ConfigError(f"{place}: expected a name that ends in {known}, or in / for a folder of frames")
    elif place.endswith(os.sep) or ending is None:
        target = Target(path, named or INRIA, True)
    elif named not in (None, ending):
        expected = f"expected a name that ends in .{named.key}, or in / for a folder"
        raise ConfigError(f"{place}: {expected}, got another format")
    else:
        target = Target(path, ending, False)
    if target.folder and target.path.exists() and not target.path.is_dir():
        raise ConfigError(f"{target.path}: expected a folder, got a file")
    if not target.folder and target.path.is_dir():
        raise ConfigError(f"{place}: expected a file, got a folder: end it in / to write frames into it")
    if frames != 1 and not target.many:
        hint = f"for more, name a folder and --format {target.form.key.removesuffix('-folder')}"
        raise ConfigError(f"{place}: expected one frame, got {frames} (--frames N; {hint})")
    return target


def write_frames(
    target: Target, frames: Iterable[Numbered], fps: Fraction, background: Background = BLACK, origin: Origin = ZERO
) -> list[str]:
    """Write numbered frames; returns a line for each kind of loss.

    A folder of frames without a sequence.json gets one, with the frame rate and the background. Where the positions of
    frames are from an `origin`, a format of doubles has that added; for others sequence.json has it. What is replaced
    stays until all frames are written. Raises SceneError, and what the iterator of frames raises.
    """
    losses, doubles = Losses(target.form.holds, target.form.name), target.form.holds.doubles
    fitted = ((number, losses.fit(g, f"frame {number}")) for number, g in frames)
    if doubles and origin != ZERO:
        fitted = ((number, in_world(g, origin)) for number, g in fitted)
    own = Settings(fps, background=background, origin=ZERO if doubles else origin)
    settled = target.many and not (target.path / SETTINGS_NAME).exists()
    target.path.parent.mkdir(parents=True, exist_ok=True)
    with (staged_files if target.folder else atomic_path)(target.path) as temporary:
        try:
            for number, gaussians in fitted:
                name = f"{number:06d}.{target.form.key}"
                target.form.write(temporary / name if target.many else temporary, gaussians)
        except SceneError as error:  # of a name that nobody has given
            raise SceneError(str(error).replace(str(temporary), str(target.path))) from error
        if settled:
            write_settings(temporary, own)
    way = f"{SETTINGS_NAME} says it" if settled else "add that"
    return losses.lines() + [f"{target.form.name} has positions from {origin}: {way}"] * (own.origin != ZERO)


def write(gaussians: Gaussians | Mapping[str, Any], path: str | Path) -> list[str]:
    """Write one frame in the format that the ending of `path` tells; returns a line for each kind of loss.

    The frame is Gaussians or, as in `Sequence.from_arrays`, a mapping of arrays. A path without an ending is a folder,
    for frames of .ply. Raises ConfigError for a path that does not suit, SceneError for what is no frame.
    """
    target = choose_target(str(path_argument("path", path)), None, 1)
    return write_frames(target, [(0, as_gaussians(gaussians))], DEFAULT_FPS)
