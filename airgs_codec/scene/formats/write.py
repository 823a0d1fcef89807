"""Frames to files of any format: which one a name asks for, and all of them written or none."""

from __future__ import annotations

import importlib.util
import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path

from airgs_codec._arguments import argument, path_argument
from airgs_codec.errors import ConfigError, SceneError
from airgs_codec.places.whole import atomic_path, staged_files
from airgs_codec.scene.beside import DEFAULT_FPS, SETTINGS_NAME, Settings, write_settings
from airgs_codec.scene.camera import BLACK, Background
from airgs_codec.scene.formats.form import FrameFormat, Losses
from airgs_codec.scene.formats.ply import INRIA
from airgs_codec.scene.formats.sog import META_NAME, SOG, write_sog_folder
from airgs_codec.scene.formats.table import FRAMES
from airgs_codec.scene.gaussians import Gaussians

SOG_FOLDER = replace(SOG, name="SOG folder", key="sog-folder", write=write_sog_folder)
KEYS = tuple(form.key for form in FRAMES)  # the names of formats that can be asked for
Numbered = tuple[int, Gaussians]  # a frame and its number


@dataclass(frozen=True, slots=True)
class Target:
    """A place for frames: a file, a folder of files 000000.spz and on, or one frame that is a folder."""

    path: Path
    form: FrameFormat
    folder: bool


def choose_target(place: str, key: str | None, frames: int) -> Target:
    """Return where so many frames go, by the format's name or the ending of a place.

    A place may have any name: one that ends like no format is a folder of frames; so is what ends in a slash or exists
    as a folder. Raises ConfigError when the ending is that of another format, the place does not suit the number of
    frames or is in the way, or the library that writes is not there.
    """
    if not place:
        raise ConfigError("expected the name of a file or folder for the frames, got an empty one")
    path = Path(place)
    named = next((form for form in FRAMES if form.key == key), None)
    endings = [form for form in FRAMES if path.name.lower().endswith(f".{form.key}")]
    ending = max(endings, key=lambda form: len(form.key), default=None)
    if path.name == META_NAME and named in (None, SOG):
        target = Target(path.parent, SOG_FOLDER, True)
    elif place.endswith(os.sep) or ending is None:
        target = Target(path, named or INRIA, True)
    elif named not in (None, ending):
        raise ConfigError(
            f"{place}: expected a name that ends in .{named.key}, or in / for a folder, got another format"
        )
    else:
        target = Target(path, ending, False)
    _check(place, target, frames)
    return target


def _check(place: str, target: Target, frames: int) -> None:
    """Raise ConfigError when frames cannot be written there."""
    if target.folder and target.path.exists() and not target.path.is_dir():
        raise ConfigError(f"{target.path}: expected a folder, got a file")
    if not target.folder and target.path.is_dir():
        raise ConfigError(f"{place}: expected a file, got a folder: end it in / to write frames into it")
    if frames != 1 and (not target.folder or target.form is SOG_FOLDER):
        hint = f"for more, name a folder and --format {target.form.key.removesuffix('-folder')}"
        raise ConfigError(f"{place}: expected one frame, got {frames} (--frames N; {hint})")
    if (need := target.form.writer) and importlib.util.find_spec(need) is None:
        raise ConfigError(f"{place}: {target.form.name} needs {need}: pip install 'airgs-codec[formats]'")


def write_frames(
    target: Target, frames: Iterable[Numbered], fps: Fraction, background: Background = BLACK
) -> list[str]:
    """Write numbered frames, so many a second; returns what is lost of them, a line for each kind.

    A folder of frames without a sequence.json gets one, with the frame rate and the background.

    A file or folder that is there keeps what it has until all frames are written, and then what is not replaced by a
    frame of the same name. Raises SceneError, and what the iterator of frames raises.
    """
    losses = Losses(target.form.holds, target.form.name)
    fitted = ((number, losses.fit(g, f"frame {number}")) for number, g in frames)
    with _made_folders(target.path), (staged_files if target.folder else atomic_path)(target.path) as temporary:
        try:
            if target.folder and target.form is not SOG_FOLDER:
                for number, gaussians in fitted:
                    target.form.write(temporary / f"{number:06d}.{target.form.key}", gaussians)
                if not (target.path / SETTINGS_NAME).exists():
                    write_settings(temporary, Settings(fps, background=background))
            else:
                target.form.write(temporary, *(g for _, g in fitted))
        except SceneError as error:  # of a name that nobody has given
            raise SceneError(str(error).replace(str(temporary), str(target.path))) from error
    return losses.lines()


def write(gaussians: Gaussians, path: str | Path) -> list[str]:
    """Write one frame in the format that the ending of `path` tells; returns what is lost, a line for each kind.

    A file there is replaced once the new one is whole. A path that ends like no format is a folder, for frames of .ply.
    Raises ConfigError for a path that does not suit, SceneError where no Gaussian is finite.
    """
    frame = argument("gaussians", gaussians, Gaussians, "Gaussians")
    return write_frames(choose_target(str(path_argument("path", path)), None, 1), [(0, frame)], DEFAULT_FPS)


@contextmanager
def _made_folders(path: Path) -> Iterator[None]:
    """Within the block all folders above a path are there; after an error those that were made are gone again."""
    missing = [folder for folder in path.absolute().parents if not folder.exists()]
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield
    except BaseException:
        for folder in missing:
            with suppress(OSError):
                folder.rmdir()
        raise
