"""A day of live publishing: what a package that grows for hours costs its publisher, and viewers who join late.

    python -m tools.soak_live -o OUT [--hours 24] [--joiners 49] [--seed 1] [--scene DIR] [--scratch DIR]

One second of a scene, by default the embedded fox, its first five frames there and back, is encoded once. Its files
stand for every group of the day: `GrowingPackage`, which airgs-encode --follow publishes with, adds a group for each
second, as fast as it can, with a table of its own, and writes manifest.mpd, airgs.json and full pages of the index into
a folder in --scratch (default: /dev/shm where there is one, since every file is synchronised to the disk). Viewers join
at moments drawn from the seed, the last one at the end: in another process the player opens the package over HTTP from
a server of this machine. Counted is what it fetches until the files of its first segment are there, headers included.

Writes OUT/soak.json, OUT/soak.csv (a row for each viewer) and OUT/soak.png, and prints the first and the last row:

    hour        of the day, when the viewer joins
    groups      so far
    root        bytes of airgs.json, which a viewer asks for again with every group
    mpd         bytes of manifest.mpd
    requests    of the viewer before its first picture
    tables      bytes of its tables among them, airgs.json included
    start       bytes of all of them
    memory      VmRSS of the publisher, MB
    publish     milliseconds of its CPU for a group, the mean since the viewer before
"""

from __future__ import annotations

import argparse
import csv
import json
import multiprocessing
import os
import random
import re
import shutil
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, fields, replace
from datetime import UTC, datetime
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

from airgs_codec._report import new_figure, require_matplotlib, save_figure, table
from airgs_codec.encoder.publish import encode
from airgs_codec.encoder.settings import EncodeSettings
from airgs_codec.errors import AirgsError, ConfigError
from airgs_codec.package.folder import Folder
from airgs_codec.package.mpd import LiveClock
from airgs_codec.package.paths import JSON_NAME, MPD_NAME, FileKind, file_kind
from airgs_codec.package.store import open_package
from airgs_codec.package.tables import Group
from airgs_codec.package.writing import GrowingPackage, write_root
from airgs_codec.play.events import Arrived, BatchKind
from airgs_codec.play.http import HttpDownloader
from airgs_codec.play.policies.named import DEFAULT_POLICY, make_policy
from airgs_codec.play.run import run
from airgs_codec.play.settings import SessionSettings
from airgs_codec.scene.sequence import open_sequence

FOX = Path(__file__).parent.parent / "tests" / "data" / "fox"
FPS = 24
SECOND = (0, 1, 2, 3, 4, 3, 2, 1) * 3  # frames of the fox, FPS of them
MEMORY = Path("/dev/shm")


@dataclass(frozen=True, slots=True)
class Row:
    """A viewer, and the publisher at that moment."""

    hour: float
    groups: int
    root: int  # bytes
    mpd: int  # bytes
    requests: int
    tables: int  # bytes
    start: int  # bytes
    memory: float  # MB
    publish: float  # ms


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
        """How many there are by now."""
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
    """What stands before and behind the number of a file, and that."""
    head, _, name = path.rpartition("/")
    number, dot, tail = name.partition(".")
    return f"{head}/", int(number), dot + tail


def _moved(group: Group, frames: int) -> Group:
    """The same group so many frames later."""
    segments = [replace(s, start=s.start + frames, stop=s.stop + frames) for s in group.segments]
    return replace(group, start=group.start + frames, stop=group.stop + frames, segments=segments)


def soak(scene: Path, hours: float, joiners: int, seed: int, scratch: Path | None) -> Iterator[Row]:
    """Publish the day; a row for each viewer. Raises ConfigError, SceneError."""
    last = round(3600 * hours)
    if last < 2 or joiners < 1:
        raise ConfigError(f"expected at least 2 s and 1 joiner, got {last} s and {joiners}")
    draws = random.Random(seed)
    moments = {draws.randrange(2, last) for _ in range(joiners - 1)} if last > 2 else set()
    with _scratch(scratch) as folder, multiprocessing.get_context("spawn").Pool(1) as viewers:
        day = Day(folder / "day.airgs", scene)
        done, since_s = day.groups, time.process_time()
        for count in sorted({*moments, last}):
            while day.groups < count:
                day.add(day.groups == count - 1)
            each_s = (time.process_time() - since_s) / (count - done)
            found = viewers.apply(join, (str(day.folder),))
            yield _row(day, found, each_s)
            done, since_s = count, time.process_time()
        day.package.close()


def _row(day: Day, found: tuple[int, int, int], each_s: float) -> Row:
    root, mpd = ((day.folder / name).stat().st_size for name in (JSON_NAME, MPD_NAME))
    kilobytes = re.search(r"VmRSS:\s+(\d+) kB", Path("/proc/self/status").read_text())
    memory = int(kilobytes[1]) / 1e3 if kilobytes else 0.0
    return Row(day.groups / 3600, day.groups, root, mpd, *found, memory, 1e3 * each_s)


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
    with _serving(folder) as url, HttpDownloader(url) as downloader:
        catalogue = downloader.open()
        policy = make_policy(DEFAULT_POLICY, catalogue)
        for event in run(catalogue, downloader, policy, SessionSettings()):
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


class _Quiet(SimpleHTTPRequestHandler):
    protocol_version = "HTTP/1.1"

    def log_message(self, *args: object) -> None:
        """Nothing is said of requests."""


@contextmanager
def _serving(folder: str) -> Iterator[str]:
    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(_Quiet, directory=folder))
    server.daemon_threads = True
    threading.Thread(target=server.serve_forever, args=(0.01,), daemon=True).start()
    try:
        yield f"http://127.0.0.1:{server.server_address[1]}"
    finally:
        server.shutdown()
        server.server_close()


def plot(rows: Sequence[Row], path: Path) -> None:
    """Draw bytes at the start and memory over the hours."""
    figure = new_figure(8, 5)
    bytes_, memory = figure.subplots(2, sharex=True)
    hours = [row.hour for row in rows]
    for name, words in (("start", "before the first picture"), ("tables", "tables of it"), ("root", "airgs.json")):
        bytes_.plot(hours, [getattr(row, name) / 1e3 for row in rows], ".-", label=words)
    bytes_.plot(hours, [row.mpd / 1e3 for row in rows], ".-", label="manifest.mpd")
    largest = max(row.start for row in rows) / 1e3
    bytes_.set(ylabel="kB", yscale="log", ylim=(1, 6 * largest), title="A viewer who joins late")  # room for the legend
    memory.plot(hours, [row.memory for row in rows], ".-", color="tab:red")
    most = 1.2 * max(row.memory for row in rows)
    memory.set(xlabel="hours of publishing", ylabel="MB", ylim=(0, most), title="Memory of the publisher (VmRSS)")
    bytes_.legend(loc="upper center", ncols=4, fontsize=8)
    for axes in (bytes_, memory):
        axes.grid(alpha=0.3)
    save_figure(figure, path)


def _words(rows: Sequence[Row]) -> list[str]:
    names = [field.name for field in fields(Row)]
    cells = [[f"{value:.1f}" if isinstance(value, float) else str(value) for value in asdict(r).values()] for r in rows]
    return table(names, cells)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the day as the arguments say; returns the exit status."""
    parser = argparse.ArgumentParser(prog="tools.soak_live", description="A day of live publishing.")
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="OUT", help="folder of the results")
    parser.add_argument("--scene", type=Path, default=FOX, metavar="DIR", help="of five frames or more (default: fox)")
    parser.add_argument("--hours", type=float, default=24.0, help="of publishing (default: 24)")
    parser.add_argument("--joiners", type=int, default=49, metavar="N", help="viewers (default: 49)")
    parser.add_argument("--seed", type=int, default=1, help="of the moments when they join (default: 1)")
    parser.add_argument("--scratch", type=Path, metavar="DIR", help="where the package is made (default: in memory)")
    args = parser.parse_args(argv)
    try:
        require_matplotlib("soak.png")
        args.output.mkdir(parents=True, exist_ok=True)
        since_s, rows = time.monotonic(), []
        for row in soak(args.scene, args.hours, args.joiners, args.seed, args.scratch):
            rows.append(row)
            print("\n".join(_words([row])[min(1, len(rows) - 1) :]), flush=True)
    except AirgsError as error:
        print(f"soak_live: {error}", file=sys.stderr)
        return 2
    with (args.output / "soak.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, [field.name for field in fields(Row)], lineterminator="\n")
        writer.writeheader()
        writer.writerows(asdict(row) for row in rows)
    plot(rows, args.output / "soak.png")
    took = {"seconds": round(time.monotonic() - since_s, 1), "hours": args.hours, "cores": os.cpu_count()}
    ends = {"first": asdict(rows[0]), "last": asdict(rows[-1])}
    (args.output / "soak.json").write_text(json.dumps(took | ends, indent=1))
    print("\n".join(_words([rows[0], rows[-1]])))
    return 0


if __name__ == "__main__":
    sys.exit(main())
