"""Files and folders of this machine that are whole or absent, and JSON that every reader accepts.

What is written has a random name until it is finished, and no link is followed. Its owner holds a lock of the kernel on
it (flock), which ends with the process; whoever writes to the same path next removes what nobody holds. Locks of files
work on a network disk too, those of folders only among the processes of one machine; without locks nothing is removed.
"""

from __future__ import annotations

import errno
import json
import math
import mimetypes
import os
import re
import secrets
import shutil
import stat
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from tokenize import TokenError
from typing import Any

from airgs_codec.errors import AirgsError, ConfigError

try:
    import fcntl
except ImportError:  # on Windows, which has no such locks: there packages are only read
    fcntl = None  # type: ignore[assignment]

_PART = re.compile(r"(.*/)?\.([^/]+)\.[0-9a-f]{16}\.part")  # what `atomic_path` writes, below any folder
_MARK_NAME, _MARK = "airgs-unfinished", b"airgs-codec makes a folder here; nothing else may be put beside it\n"
_OURS = ".ply .spz .sog .splat .splatv .ksplat .4dgs .splat4d .glb .gltf .usdz .fbx .mpd .m4s .webp .mkv .npz .7z"
_FILES = {*mimetypes.MimeTypes().types_map[True], *_OURS.split(), ".gz"}  # endings of names
_NEW, _OLD, _GONE = "new", "old", "gone"  # folders next to the mark; what is in the last is being deleted
WAIT_S = 10.0  # for another run that writes to a folder
_POLL_S = 0.02

BROKEN = (  # what reading broken JSON and arrays raises
    *(ValueError, TypeError, LookupError, AttributeError, ArithmeticError, ImportError, EOFError, RuntimeError),
    *(SyntaxError, TokenError, MemoryError),  # of the header of an array: numpy parses it as Python
)
IsOurs = Callable[[Path], bool]  # whether a folder with files in it is of the kind that may be replaced


def expect_folder_name(place: str | Path, ending: str = "") -> None:
    """Raise ConfigError for a missing folder that has the ending of a file; `ending`: what is expected."""
    path = Path(place)
    if path.suffix.lower() in _FILES and not str(place).endswith(os.sep) and not path.is_dir():
        other = f" or a name that ends in {ending}" * bool(ending)
        raise ConfigError(f"{place}: expected a folder{other}, got a name that ends in {path.suffix}")


@contextmanager
def naming(path: Path, temporary: Path | None = None) -> Iterator[None]:
    """Within the block an error of the file system that names no file, or one in `temporary`, names `path`."""
    try:
        yield
    except OSError as error:
        ours = temporary is not None and str(error.filename).startswith(str(temporary))
        if not isinstance(error, AirgsError) and (error.filename is None or ours):
            error.filename = str(path)
        raise


def expect_plain(path: Path) -> None:
    """Raise OSError for a pipe, a device or a socket, which a reader might wait for without an end."""
    with suppress(FileNotFoundError):
        if not (stat.S_ISREG(mode := os.stat(path).st_mode) or stat.S_ISDIR(mode)):
            raise OSError(errno.EINVAL, "expected a plain file, got a pipe, a device or a socket", str(path))


@contextmanager
def atomic_path(path: Path) -> Iterator[Path]:
    """Give a new empty file next to `path`; what the block writes into it replaces `path` when the block ends.

    The bytes are on the disk (fsync) before the file has its name, so that a crash leaves the old file or the new one.
    After an error the temporary file is removed and `path` is as it was. What killed runs left of `path` is removed
    first.
    """
    remove_leftovers(path.parent, path.name)
    while True:
        temporary = path.with_name(f".{path.name}.{secrets.token_hex(8)}.part")
        lock = _opened(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666)
        if _holds(lock) is not False and os.fstat(lock).st_nlink:  # else somebody took it for a leftover
            break
        os.close(lock)
    try:
        with naming(path, temporary):
            yield temporary
            _finish(temporary)
            temporary.replace(path)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise
    finally:
        os.close(lock)


def remove_leftovers(folder: Path, name: str | None = None) -> None:
    """Remove unfinished files of killed runs in a folder: those for a `name`, or all."""
    with suppress(OSError):  # of a folder that cannot be listed
        for entry in os.listdir(folder):
            if entry.endswith(".part") and (match := _PART.fullmatch(entry)) and name in (None, match[2]):
                # An error: it is finished by now, or a link, or somebody else's.
                with suppress(OSError), open(_opened(folder / entry, os.O_WRONLY | os.O_NONBLOCK), "wb") as file:
                    if _holds(file.fileno()):
                        os.unlink(folder / entry)


def finished_path(path: str) -> str:
    """Return the path for which `atomic_path` made an unfinished file, and any other path as it is."""
    match = _PART.fullmatch(path)
    return f"{match[1] or ''}{match[2]}" if match else path


@contextmanager
def staged_files(folder: Path) -> Iterator[Path]:
    """Give a temporary folder inside `folder`, which is made; its files go to `folder` when the block ends.

    They replace those of the same names, each whole and all of one run together; others stay. After an error nothing
    has changed.
    """
    new = not folder.exists()
    folder.mkdir(exist_ok=True)
    try:
        with ExitStack() as held:
            with written_alone(folder):
                _clean_up(folder, ".airgs-")
                work = held.enter_context(_work_folder(folder, ".airgs-"))
            with naming(folder, work):
                yield work / _NEW
                paths = sorted((work / _NEW).iterdir())
                for path in paths:
                    _finish(path)
                with written_alone(folder):
                    for path in paths:
                        path.replace(folder / path.name)
    except BaseException:
        if new:
            with suppress(OSError):  # another run has written there
                folder.rmdir()
        raise


@contextmanager
def staged_folder(target: Path, is_ours: IsOurs, kind: str) -> Iterator[Path]:
    """Give an empty folder that replaces `target` when the block ends without an error.

    It lies in a marked work folder next to `target`. An existing folder of ours is moved there before and deleted
    after; any other one with files in it is refused. Work folders of runs that were killed are repaired first: a folder
    of ours that was moved comes back, all else in them is removed.

    Raises ConfigError, which calls what it expects a `kind`, for a file, a link, a folder with other files, or another
    run that writes it.
    """
    target.parent.mkdir(parents=True, exist_ok=True)
    prefix = f".{target.name}.airgs-"
    with ExitStack() as held:
        with written_alone(target.parent):
            if _clean_up(target.parent, prefix, target):
                raise ConfigError(f"{target}: expected to be alone, got another run that is making this {kind}")
            _expect_ours(target, is_ours, kind)
            if target.exists():
                with written_alone(target, wait_s=0):
                    pass
            work = held.enter_context(_work_folder(target.parent, prefix, target))
        with naming(target, work):
            yield work / _NEW
            with ExitStack() as last:
                last.enter_context(written_alone(target.parent))
                _expect_ours(target, is_ours, kind)  # somebody may have written there since
                if target.exists():
                    last.enter_context(written_alone(target))
                    target.rename(work / _OLD)
                (work / _NEW).rename(target)


@contextmanager
def written_alone(folder: Path, wait_s: float | None = None) -> Iterator[None]:
    """Hold the lock on this folder. Raises ConfigError where another run has it for longer than `wait_s`, or WAIT_S."""
    end = time.monotonic() + (WAIT_S if wait_s is None else wait_s)
    while (lock := _lock_of(folder)) is None:
        if time.monotonic() > end:
            raise ConfigError(f"{folder}: expected to be alone, got another run that is writing there")
        time.sleep(_POLL_S)
    try:
        yield
    finally:
        os.close(lock)


def _lock_of(folder: Path) -> int | None:
    """Return an open folder whose lock this process has; None where another has it or has just replaced the folder."""
    _expect_locks(folder)
    with suppress(FileNotFoundError), ExitStack() as opened:
        lock = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
        opened.callback(os.close, lock)
        if _holds(lock) is not False and os.path.samestat(os.fstat(lock), os.stat(folder)):
            opened.pop_all()
            return lock
    return None


def _holds(file: int) -> bool | None:
    """Return whether this process has the lock of an open file now; None on a disk without locks."""
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        return None
    return True


def write_bytes(path: Path, data: bytes) -> None:
    with atomic_path(path) as temporary, open(_opened(temporary, os.O_WRONLY), "wb") as file:
        file.write(data)


def write_json(path: Path, value: Any) -> None:
    write_bytes(path, f"{to_json(value, indent=1)}\n".encode())


def to_json(value: Any, indent: int | None = None) -> str:
    """Return JSON of mappings, sequences and plain values; a float that is not finite becomes null."""
    return json.dumps(_plain(value), indent=indent, allow_nan=False)


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {name: _plain(v) for name, v in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _finish(path: Path) -> None:
    """Have the bytes of a file on the disk. Raises OSError where a link is in its place."""
    with open(_opened(path, os.O_RDONLY), "rb") as file:
        os.fsync(file.fileno())


def _expect_locks(path: Path) -> None:
    if fcntl is None:
        words = "expected file locks of POSIX, which are not here; on Windows use WSL"
        raise ConfigError(f"{finished_path(str(path))}: {words}")


def _opened(path: Path, flags: int, mode: int = 0o600) -> int:
    _expect_locks(path)
    return os.open(path, flags | os.O_NOFOLLOW, mode)


def _expect_ours(target: Path, is_ours: IsOurs, kind: str) -> None:
    if target.is_symlink() or (target.exists() and not target.is_dir()):
        got = "a link" if target.is_symlink() else "a file"
        raise ConfigError(f"{target}: expected a folder for the {kind}, got {got}")
    if target.is_dir() and any(target.iterdir()) and not is_ours(target):
        raise ConfigError(f"{target}: expected a new folder or an existing {kind}, got a folder with other files")


@contextmanager
def _work_folder(parent: Path, prefix: str, target: Path | None = None) -> Iterator[Path]:
    """Give a new marked folder with an empty folder in it, which is removed when the block ends."""
    work = parent / f"{prefix}{secrets.token_hex(8)}"
    work.mkdir(0o700)
    with open(_opened(work / _MARK_NAME, os.O_RDWR | os.O_CREAT | os.O_EXCL), "wb", buffering=0) as mark:
        try:
            _holds(mark.fileno())
            mark.write(_MARK)
            (work / _NEW).mkdir()
            yield work
        finally:
            _remove(work, target)


def _clean_up(parent: Path, prefix: str, target: Path | None = None) -> bool:
    """Remove work folders of dead runs; returns whether a living run has one."""
    own, busy = re.compile(rf"{re.escape(prefix)}[0-9a-f]{{16}}"), False
    for work in [path for path in parent.iterdir() if own.fullmatch(path.name) and not path.is_symlink()]:
        mark = work / _MARK_NAME
        # Whoever made it may have died before the mark was written.
        if mark.is_symlink() or not mark.is_file() or not _MARK.startswith(mark.read_bytes()):
            with suppress(OSError):  # it is not empty, so it is not ours
                work.rmdir()
            continue
        with open(_opened(mark, os.O_RDWR), "rb") as file:
            if held := _holds(file.fileno()):
                _remove(work, target)
            busy = busy or held is False
    return busy


def _remove(work: Path, target: Path | None) -> None:
    """Delete a work folder; what was to be replaced comes back where nothing has replaced it.

    It is called `_GONE` before any of it is deleted, so that what comes back is whole; the mark goes last.
    """
    with suppress(OSError):  # what cannot be moved stays, and the mark with it, for the next run
        if target is not None and (work / _OLD).is_dir():
            (work / _OLD).rename(work / _GONE if target.exists() else target)
        for path in work.iterdir():
            if path.name != _MARK_NAME:
                shutil.rmtree(path)
        (work / _MARK_NAME).unlink()
        work.rmdir()
