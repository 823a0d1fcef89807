"""What commands share: checks of options, and the options that several of them have."""

from __future__ import annotations

import importlib.util
import re
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypedDict

from airgs_codec._report import require_matplotlib
from airgs_codec._settings import required, setting
from airgs_codec.cli.terminal import Bar, warn
from airgs_codec.errors import ConfigError
from airgs_codec.places.whole import expect_folder_name
from airgs_codec.scene.beside import exact_number
from airgs_codec.scene.beside import frame_rate as rate_of

if TYPE_CHECKING:
    from airgs_codec.jobs.engines import Engine
    from airgs_codec.jobs.work import Work
    from airgs_codec.package.tables import World
    from airgs_codec.progress import Progress
    from airgs_codec.scene.sequence import GaussianSequence


def parse_frames(text: str | None) -> tuple[int, int | None]:
    """First frame and the one after the last of A:B, A:, :B or a single number; None stands for the end.

    Without text, all frames. Raises ConfigError.
    """
    head, colon, tail = (text or ":").partition(":")
    try:
        start = int(head) if head else 0
        return start, (int(tail) if tail else None) if colon else start + 1
    except ValueError as error:
        raise ConfigError(f"--frames: expected A:B, got {text!r}") from error


def parse_range(text: str, frames: int) -> tuple[int, int]:
    """(start, stop) as `parse_frames` gives it, of a sequence of `frames`. Raises ConfigError."""
    start, stop = parse_frames(text)
    stop = frames if stop is None else stop
    if not 0 <= start < stop <= frames:
        raise ConfigError(f"--frames: expected A:B inside 0:{frames}, got {text!r}")
    return start, stop


PACKAGE = "a package: its folder, or its address, s3://, gs:// or az://"
DEVICES = ("auto", "cpu", "cuda")
DASK = re.compile(r"dask(?::(.+))?")


def package() -> Any:
    return required(PACKAGE)


def views(purpose: str, default: str) -> Any:
    """Returns the field of --views; `purpose` says what the cameras are for, `default` which are taken without it."""
    return setting(None, f"{purpose} (default: {default}); docs/encoding.md lists the forms of cameras", metavar="PATH")


def device(purpose: str, topic: str | None = None) -> Any:
    """Returns the field of --device; `purpose` says what the device is for."""
    words = f"{purpose}; cuda needs a GPU and the cuda extra, auto takes it where it can"
    return setting("auto", words, choices=DEVICES, topic=topic)


def frames(words: str = "all") -> Any:
    """Returns the field of --frames; `words` says which frames are taken without it."""
    return setting(":", "frames A to B - 1, or one frame", metavar="A:B", default=words)


def report(words: str) -> Any:
    return setting(None, f"folder for {words}", metavar="DIR")


def as_json(words: str = "print figures as JSON") -> Any:
    return setting(False, words)


def fraction(text: str) -> Fraction:
    """Returns an exact number, of 30, 29.97 or 30000/1001. Raises ValueError."""
    return exact_number(text)


def read_rate(text: str) -> Fraction:
    """Returns frames a second. Raises ValueError for what is no number, SceneError for what is no rate."""
    return rate_of("frames a second", exact_number(text))


def frame_rate() -> Any:
    return setting(None, "frames a second (default: what the scene says, else 30)", read=read_rate, metavar="FPS")


class Baking(TypedDict):
    """Arguments of `open_sequence`; None: what the file says, or else the default of its format."""

    bake_fps: Fraction | None
    duration: Fraction | None


@dataclass(frozen=True, slots=True)
class BakingOptions:
    bake_fps: Fraction | None = setting(
        None,
        "frames a second that a clip of moving Gaussians is baked to (default: what the file says, else 30)",
        read=read_rate,
        metavar="FPS",
    )
    duration: Fraction | None = setting(
        None,
        "length of a clip whose file states none: .splatv, Spacetime Gaussians .ply (default: 5/3)",
        read=fraction,
        metavar="S",
    )

    def baking(self) -> Baking:
        return {"bake_fps": self.bake_fps, "duration": self.duration}

    def given(self) -> bool:
        return self != BakingOptions()


def read_up(text: str) -> tuple[float, ...]:
    """Returns the direction that a text names. Raises ConfigError."""
    from airgs_codec.package.region import parse_up

    return parse_up(text)


@dataclass(frozen=True, slots=True)
class WorldOptions:
    """Which way is up and how long a unit is: for players, nothing is turned or scaled."""

    up: tuple[float, ...] | None = setting(
        None,
        "direction that points up in the frames, x, -y, … or X,Y,Z; by default what the format of the frames specifies",
        read=read_up,
        metavar="AXIS",
        signed=True,
    )
    unit: float | None = setting(None, "with --up: how many metres a unit of the frames is long", metavar="METRES")
    transform: Path | None = setting(
        None,
        "instead of these: 3x4 or 4x4 numbers row by row, text or JSON, from the frames to a world with y up in "
        "metres: a turn, one scale, a shift",
        metavar="FILE",
    )

    def world(self) -> World | None:
        """Returns where the scene stands, as far as the options say. Raises ConfigError."""
        from airgs_codec.package.region import read_world, world_from

        if self.transform:
            if self.up or self.unit is not None:
                raise ConfigError("--transform: expected neither --up nor --unit with it: it says both")
            return read_world(self.transform)
        if self.up:
            return world_from(self.up, self.unit)
        if self.unit is not None:
            raise ConfigError("--unit: expected --up with it")
        return None


@dataclass(frozen=True, slots=True)
class WorkOptions:
    """Who does the work (docs/farm.md): processes of this machine, or a Dask cluster."""

    jobs: int = setting(1, "processes that share the work")
    work: str | None = setting(
        None,
        "where finished jobs stay, so that a run that was cut off goes on; a folder that all workers see, or s3://, "
        "gs://, az:// and a prefix; who may write there decides what comes out; by default a temporary folder",
        metavar="PLACE",
    )
    executor: str | None = setting(
        None,
        "a Dask cluster does the work: the one whose scheduler is at ADDRESS, which needs --work, or one of --jobs "
        "processes on this machine",
        metavar="dask[:ADDRESS]",
    )

    def shared_by(self) -> str | None:
        """Returns the first of the options that is given; None where one process does everything by itself."""
        given = {"--jobs": self.jobs != 1, "--executor": self.executor, "--work": self.work}
        return next((name for name, value in given.items() if value), None)

    @contextmanager
    def opened(self, progress: Progress) -> Iterator[Work]:
        """Give what the options ask for, until the block ends. Raises ConfigError for options that cannot work."""
        from airgs_codec.jobs.work import Work
        from airgs_codec.places.results import open_store

        if self.jobs < 1:
            raise ConfigError(f"--jobs: expected at least one process, got {self.jobs}")
        with tempfile.TemporaryDirectory(prefix="airgs-work-") as folder:
            store = open_store(self.work) if self.work else open_store(Path(folder), lasting=False)
            engine = self._engine()
            try:
                yield Work(store, engine, progress)
            finally:
                engine.close()

    def _engine(self) -> Engine:
        from airgs_codec.jobs.engines import InProcess, Processes

        if self.executor is None:
            return Processes(self.jobs) if self.jobs > 1 else InProcess()
        found = DASK.fullmatch(self.executor)
        if not found:
            raise ConfigError(f"--executor: expected dask or dask:ADDRESS, got {self.executor!r}")
        if found[1] and not self.work:
            raise ConfigError("--executor dask:ADDRESS: expected --work, a place that all workers see, got none")
        if importlib.util.find_spec("distributed") is None:
            raise ConfigError("--executor dask needs Dask: pip install 'airgs-codec[farm]'")
        from airgs_codec.jobs.dask_engine import DaskEngine

        return DaskEngine.at(found[1]) if found[1] else DaskEngine.local(self.jobs)


def open_frames(place: str, *, quiet: bool = False, **how: Any) -> GaussianSequence:
    """Return the sequence at a place; copying it from an address shows a bar, and a line of what was copied.

    `how`: arguments of `open_sequence`, which says what is raised.
    """
    from airgs_codec.scene.sequence import open_sequence

    with closing(Bar(quiet)) as bar:
        sequence = open_sequence(place, progress=bar, **how)
    if sequence.copied and not quiet:
        warn(str(sequence.copied))
    return sequence


def expect_report(folder: Path | None) -> None:
    """Raise ConfigError where a report cannot be drawn, or a file is where its folder should be."""
    if folder:
        require_matplotlib("--report")
        expect_folder_name(folder)
        expect_folder(folder)


def expect_room(folder: Path, size: int) -> None:
    """Raise ConfigError where so many bytes do not fit the disk that a folder is on, before the work begins."""
    free = shutil.disk_usage(folder).free
    if free < size:
        raise ConfigError(f"{folder}: expected {size / 1e9:.1f} GB of room for what waits, got {free / 1e9:.1f} GB")


def expect_folder(path: Path) -> None:
    """Raise ConfigError where no folder can be made or written, before the work begins."""
    there = next(place for place in (path.absolute(), *path.absolute().parents) if place.exists())
    if not there.is_dir():
        raise ConfigError(f"{there}: expected a folder, got a file")
    try:
        tempfile.TemporaryFile(dir=there).close()
    except OSError as error:
        raise ConfigError(f"{path}: expected a folder that can be written: {error.strerror}") from error
