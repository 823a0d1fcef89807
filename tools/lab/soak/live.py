"""A day of live publishing: what a package that grows for hours costs its publisher, and viewers who join late.

One second of a scene, by default the embedded fox, its first five frames there and back, is encoded once. Its files
stand for every group of the day: `GrowingPackage`, which airgs-encode --follow publishes with, adds a group for each
second, as fast as it can, with a table of its own, and writes manifest.mpd, airgs.json and full pages of the index into
a folder in --scratch (default: /dev/shm where there is one, since every file is synchronised to the disk). Viewers join
at moments drawn from the seed, the last one at the end: in another process the player opens the package over HTTP from
a server of this machine. Counted is what it fetches until the files of its first segment are there, headers included.
"""

from __future__ import annotations

import multiprocessing
import random
import shutil
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING

from airgs_codec.encoder.publish import encode
from airgs_codec.encoder.settings import EncodeSettings
from airgs_codec.errors import ConfigError
from airgs_codec.package.layout import JSON_NAME, MPD_NAME, FileKind, file_kind
from airgs_codec.package.mpd import LiveClock
from airgs_codec.package.package import open_package
from airgs_codec.package.publish import GrowingPackage, write_root
from airgs_codec.package.tables import Group
from airgs_codec.places.place import Folder
from airgs_codec.play.downloader import Arrived, BatchKind
from airgs_codec.play.http import HttpDownloader
from airgs_codec.play.player import run as play
from airgs_codec.play.policies.named import DEFAULT_POLICY, make_policy
from airgs_codec.play.settings import SessionSettings
from airgs_codec.scene.sequence import open_sequence
from tools.lab import Lab, Page, Picture, Section, Table, listed, memory_of, rows_of, setting
from tools.lab.serving import served_folder

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FOX = Path(__file__).parents[3] / "tests" / "data" / "fox"
FPS = 24
GROWN = 0.1  # share by which something may differ that does not grow
SECOND = (0, 1, 2, 3, 4, 3, 2, 1) * 3  # frames of the fox, FPS of them
MEMORY = Path("/dev/shm")


@dataclass(frozen=True, slots=True)
class Options:
    """How long, and who joins."""

    hours: float = setting(24.0, "of publishing")
    joiners: int = setting(49, "viewers")
    seed: int = setting(1, "of the moments when they join")
    scene: Path = setting(FOX, "of five frames or more")
    scratch: Path | None = setting(None, "where the package is made (default: in memory)")


@dataclass(frozen=True, slots=True)
class Moment:
    """A viewer, and the publisher at that moment."""

    hour: float  # of the day, when the viewer joins
    groups: int  # so far
    root_bytes: int  # bytes of airgs.json, which a viewer asks for again with every group
    mpd_bytes: int  # bytes of manifest.mpd
    requests: int  # of the viewer before its first picture
    table_bytes: int  # bytes of its tables among them, airgs.json included
    start_bytes: int  # bytes of all of them
    memory_mb: float  # MB of the publisher
    publish_ms: float  # milliseconds of its CPU for a group, the mean since the viewer before


def run(options: Options, lab: Lab) -> Page:
    """Publish the day."""
    moments: list[Moment] = []
    for moment in soak(options):
        moments.append(moment)
        lab.tell(
            f"hour {moment.hour:.1f}: {moment.start_bytes:,d} bytes before the first picture, {moment.memory_mb:.1f} MB"
        )
    caption = f"Bytes before the first picture, and the publisher's memory, over {options.hours:g} hours"
    picture = Picture("soak", caption, partial(draw, moments), (8, 5))
    data = [Table("soak-live", rows_of(moments))]
    return Page([Section(words(moments), pictures=[picture])], how_of(options, moments), data=data)


def how_of(options: Options, moments: Sequence[Moment]) -> str:
    """What was published, and who joined."""
    return (
        f"{moments[-1].groups:,} groups of a second are published, as many as {options.hours:g} hours have, and "
        f"{len(moments)} viewers join at random moments."
    )


def words(moments: Sequence[Moment]) -> str:
    """Whether what a viewer fetches and what a publisher needs grow from the second quarter of the day to the last."""
    quarter = max(1, len(moments) // 4)
    spans = moments[quarter : 2 * quarter] or moments[:1], moments[-quarter:]
    said: dict[bool, list[str]] = {True: [], False: []}
    for what, name, scale, unit in (
        ("what a viewer fetches before the first picture", "start_bytes", 1e-3, "kB"),
        ("the memory of the publisher", "memory_mb", 1.0, "MB"),
        ("its CPU time for a group", "publish_ms", 1.0, "ms"),
    ):
        first, last = (scale * median(getattr(moment, name) for moment in span) for span in spans)
        said[last > (1 + GROWN) * first].append(f"{what} ({first:.3g} to {last:.3g} {unit})")
    verbs = {(True, 1): "grows", (True, 0): "grow", (False, 1): "does not grow", (False, 0): "do not grow"}
    parts = [f"{listed(some)} {verbs[grows, len(some) == 1]}" for grows, some in said.items() if some]
    return f"From the second quarter of the time to the last, {'; '.join(parts)}."


class Day:
    """A package of one group that grows, by the same group again and again."""

    def __init__(self, folder: Path, place: Path) -> None:
        """`folder`: where the package is made; `place`: of the sequence that it is made of. Raises SceneError."""
        self.folder = folder
        scene = open_sequence(place, fps=FPS)
        paths, headers = zip(*((scene.paths[i], scene.headers[i]) for i in SECOND), strict=True)
        second = replace(scene, paths=paths, headers=headers, keyframes=None)
        settings = EncodeSettings(calibrate="none", measure_pictures=2, preset="veryfast", group_frames=len(SECOND))
        encode(second, folder, settings)
        m = replace(open_package(folder).manifest, live=True)
        now = datetime.now(UTC)
        write_root(Folder(folder), m, LiveClock(now, now))
        self.package = GrowingPackage(Folder(folder), m, now)
        self._first, self._files = m.groups[0], m.group_files(0)

    @property
    def groups(self) -> int:
        """Return how many there are by now."""
        return len(self.package.manifest.groups)

    def add(self, with_files: bool) -> None:
        """Publish the group once more; its files are only there if somebody will fetch them."""
        if with_files:
            self._link()
        self.package.add(_moved(self._first, self.groups * len(SECOND)))

    def _link(self) -> None:
        """The files of the next group, under its numbers."""
        groups, segments = self.groups, self.groups * len(self._first.segments)
        for path in self._files:
            head, number, tail = _split(path)
            later = f"{head}{number + (segments if path.startswith('state/') else groups)}{tail}"
            (self.folder / later).hardlink_to(self.folder / path)


def _split(path: str) -> tuple[str, int, str]:
    """Return what stands before and behind the number of a file, and that."""
    head, _, name = path.rpartition("/")
    number, dot, tail = name.partition(".")
    return f"{head}/", int(number), dot + tail


def _moved(group: Group, frames: int) -> Group:
    """The same group so many frames later."""
    segments = [replace(s, start=s.start + frames, stop=s.stop + frames) for s in group.segments]
    return replace(group, start=group.start + frames, stop=group.stop + frames, segments=segments)


def soak(options: Options) -> Iterator[Moment]:
    """Publish the day; a row for each viewer. Raises ConfigError, SceneError."""
    last = round(3600 * options.hours)
    if last < 2 or options.joiners < 1:
        raise ConfigError(f"expected at least 2 s and 1 joiner, got {last} s and {options.joiners}")
    draws = random.Random(options.seed)
    moments = {draws.randrange(2, last) for _ in range(options.joiners - 1)} if last > 2 else set()
    with _scratch(options.scratch) as folder, multiprocessing.get_context("spawn").Pool(1) as viewers:
        day = Day(folder / "day.airgs", options.scene)
        done, since_s = day.groups, time.process_time()
        for count in sorted({*moments, last}):
            while day.groups < count:
                day.add(day.groups == count - 1)
            each_s = (time.process_time() - since_s) / (count - done)
            found = viewers.apply(join, (str(day.folder),))
            yield _row(day, found, each_s)
            done, since_s = count, time.process_time()
        day.package.close()


def _row(day: Day, found: tuple[int, int, int], each_s: float) -> Moment:
    root, mpd = ((day.folder / name).stat().st_size for name in (JSON_NAME, MPD_NAME))
    memory = memory_of("self") / 1e6
    return Moment(day.groups / 3600, day.groups, root, mpd, *found, memory, 1e3 * each_s)


@contextmanager
def _scratch(scratch: Path | None) -> Iterator[Path]:
    """A folder that goes when the block ends."""
    folder = tempfile.mkdtemp(prefix="airgs-", dir=scratch or (MEMORY if MEMORY.is_dir() else None))
    try:
        yield Path(folder)
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def join(folder: str) -> tuple[int, int, int]:
    """Requests, bytes of tables and bytes of all files that a viewer fetches before its first picture."""
    requests = tables = total = 0
    with served_folder(Path(folder)) as url, HttpDownloader(url) as downloader:
        offers = downloader.open()
        policy = make_policy(DEFAULT_POLICY, offers)
        for event in play(offers, downloader, policy, SessionSettings()):
            if not isinstance(event, Arrived):
                continue
            arrival = event.arrival
            if arrival.refused:
                raise ConfigError(f"{folder}: expected all files, got {'; '.join(map(str, arrival.refused.values()))}")
            files = arrival.request.batch.files
            requests, total = requests + len(files), total + arrival.bytes
            if all(file_kind(path) is FileKind.MANIFESTS for path in files):
                tables += arrival.bytes
            if arrival.request.kind is BatchKind.GROUP:
                return requests, tables, total
    raise ConfigError(f"{folder}: expected a group, got none")


def draw(rows: Sequence[Moment], figure: Figure) -> None:
    """Draw bytes at the start and memory over the hours."""
    bytes_, memory = figure.subplots(2, sharex=True)
    hours = [row.hour for row in rows]
    for name, words in (
        ("start_bytes", "before the first picture"),
        ("table_bytes", "tables of it"),
        ("root_bytes", "airgs.json"),
    ):
        bytes_.plot(hours, [getattr(row, name) / 1e3 for row in rows], ".-", label=words)
    bytes_.plot(hours, [row.mpd_bytes / 1e3 for row in rows], ".-", label="manifest.mpd")
    largest = max(row.start_bytes for row in rows) / 1e3
    bytes_.set(ylabel="kB", yscale="log", ylim=(1, 6 * largest), title="A viewer who joins late")  # room for the legend
    memory.plot(hours, [row.memory_mb for row in rows], ".-", color="tab:red")
    most = 1.2 * max(row.memory_mb for row in rows)
    memory.set(xlabel="hours of publishing", ylabel="MB", ylim=(0, most), title="Memory of the publisher (VmRSS)")
    bytes_.legend(loc="upper center", ncols=4)
