"""Files and folders of this machine that are whole or not there, and JSON that every reader accepts.

What is written has a name of its own until it is finished. That name is random and is made exclusively, and no link is
followed: neither one that somebody put at the name of the temporary file nor one at the name that it takes.
"""

from __future__ import annotations

import fcntl
import json
import math
import mimetypes
import os
import re
import secrets
import shutil
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from airgs_codec.errors import ConfigError

PART_SUFFIX = ".part"  # of what is being written; its name starts with a dot
_PART = re.compile(r"(.*/)?\.([^/]+)\.[0-9a-f]{16}\.part")  # what `atomic_path` writes, below any folder
_MARK_NAME, _MARK = "airgs-unfinished", b"airgs-codec makes a folder here; nothing else may be put beside it\n"
_NEW, _OLD = "new", "old"  # folders beside the mark
_OURS = ".ply .spz .sog .splat .splatv .ksplat .4dgs .splat4d .glb .gltf .usdz .fbx .mpd .m4s .webp .mkv .npz .7z"
_FILES = {*mimetypes.MimeTypes().types_map[True], *_OURS.split(), ".gz"}  # endings of names

IsOurs = Callable[[Path], bool]  # whether a folder with files in it is of the kind that may be replaced


def expect_folder_name(place: str | Path, ending: str = "") -> None:
    """Raise ConfigError for a place that is no folder yet and has the ending of a file; `ending`: what is expected."""
    path = Path(place)
    if path.suffix.lower() in _FILES and not str(place).endswith(os.sep) and not path.is_dir():
        other = f" or a name that ends in {ending}" * bool(ending)
        raise ConfigError(f"{place}: expected a folder{other}, got a name that ends in {path.suffix}")


@contextmanager
def atomic_path(path: Path, lasting: bool = True) -> Iterator[Path]:
    """Give a new empty file beside `path`; what the block writes there takes the place of `path` when the block ends.

    The bytes are on the disk (fsync) before the file has its name, so that a crash leaves the old file or the new one;
    not so where it need not be `lasting`. After an error the temporary file is removed and `path` is as it was.
    """
    temporary = path.with_name(f".{path.name}.{secrets.token_hex(8)}{PART_SUFFIX}")
    os.close(os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW, 0o666))
    try:
        yield temporary
        _finish(temporary, lasting)
        temporary.replace(path)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise


def finished_path(path: str) -> str:
    """Return the path that an unfinished file of `atomic_path` was to take, and any other path as it is."""
    match = _PART.fullmatch(path)
    return f"{match[1] or ''}{match[2]}" if match else path


@contextmanager
def staged_files(folder: Path) -> Iterator[Path]:
    """Give a temporary folder inside `folder`, which is made; files written there go to `folder` when the block ends.

    They replace those of the same names, each whole; others stay. After an error nothing has changed.
    """
    new = not folder.exists()
    folder.mkdir(exist_ok=True)
    stage = Path(tempfile.mkdtemp(prefix=".", suffix=PART_SUFFIX, dir=folder))
    try:
        yield stage
        paths = sorted(stage.iterdir())
        for path in paths:
            _finish(path, lasting=True)
        for path in paths:
            path.replace(folder / path.name)
        new = False
    finally:
        shutil.rmtree(folder if new else stage, ignore_errors=True)


@contextmanager
def staged_folder(target: Path, is_ours: IsOurs, kind: str) -> Iterator[Path]:
    """Give an empty folder that takes the place of `target` when the block ends without an error.

    It lies in a work folder beside `target`, which bears a mark. An existing folder of ours is moved into that before
    and deleted after; any other one with files in it is refused, so that nothing foreign is ever lost. Work folders of
    runs that were killed are put right first: a folder of ours that was moved comes back, all else in them is removed.

    Raises ConfigError, which calls what should be there a `kind`, when there is a file, a link, or a folder with other
    files.
    """
    target.parent.mkdir(parents=True, exist_ok=True)
    with _locked(target.parent):
        _clean_up(target)
        _expect_ours(target, is_ours, kind)
        work = target.with_name(f".{target.name}.airgs-{secrets.token_hex(8)}")
        work.mkdir(0o700)
        (work / _MARK_NAME).write_bytes(_MARK)
        (work / _NEW).mkdir()
        lock = os.open(work, os.O_RDONLY)
        fcntl.flock(lock, fcntl.LOCK_EX)
    try:
        yield work / _NEW
        with _locked(target.parent):
            _expect_ours(target, is_ours, kind)  # somebody may have written there since
            if target.exists():
                target.rename(work / _OLD)
            (work / _NEW).rename(target)
    finally:
        os.close(lock)
        _remove(work, target)


def write_bytes(path: Path, data: bytes, lasting: bool = True) -> None:
    """Write a file atomically, as `atomic_path` does."""
    with (
        atomic_path(path, lasting) as temporary,
        open(os.open(temporary, os.O_WRONLY | os.O_NOFOLLOW), "wb") as file,
    ):
        file.write(data)


def write_json(path: Path, value: Any) -> None:
    """Write `to_json(value)`, indented, atomically."""
    write_bytes(path, f"{to_json(value, indent=1)}\n".encode())


def to_json(value: Any, indent: int | None = None) -> str:
    """JSON text of mappings, sequences and plain values; a float that is not finite becomes null, as JSON has none."""
    return json.dumps(_plain(value), indent=indent, allow_nan=False)


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {name: _plain(v) for name, v in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _finish(path: Path, lasting: bool) -> None:
    """Have the bytes of a file on the disk. Raises OSError where a link is in its place."""
    file = os.open(path, os.O_RDONLY | os.O_NOFOLLOW)
    try:
        if lasting:
            os.fsync(file)
    finally:
        os.close(file)


def _expect_ours(target: Path, is_ours: IsOurs, kind: str) -> None:
    if target.is_symlink():
        raise ConfigError(f"{target}: expected a folder for the {kind}, got a link")
    if target.exists() and not target.is_dir():
        raise ConfigError(f"{target}: expected a folder for the {kind}, got a file")
    if target.is_dir() and any(target.iterdir()) and not is_ours(target):
        raise ConfigError(f"{target}: expected a new folder or an existing {kind}, got a folder with other files")


@contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """Hold the only lock on this folder; the kernel frees it when the process dies."""
    lock = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield
    finally:
        os.close(lock)


def _clean_up(target: Path) -> None:
    """Remove work folders that nobody works in."""
    own = re.compile(rf"\.{re.escape(target.name)}\.airgs-[0-9a-f]{{16}}")
    for work in [path for path in target.parent.iterdir() if own.fullmatch(path.name) and _is_marked(path)]:
        lock = os.open(work, os.O_RDONLY)
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            _remove(work, target)
        except BlockingIOError:  # somebody is at work there
            pass
        finally:
            os.close(lock)


def _is_marked(path: Path) -> bool:
    """Return whether this is a work folder of `staged_folder`."""
    mark = path / _MARK_NAME
    plain = not path.is_symlink() and not mark.is_symlink() and mark.is_file()
    return plain and mark.read_bytes() == _MARK


def _remove(work: Path, target: Path) -> None:
    """Delete a work folder; what was to be replaced comes back where nothing has taken its place."""
    if (work / _OLD).is_dir() and not target.exists():
        (work / _OLD).rename(target)
    shutil.rmtree(work, ignore_errors=True)
