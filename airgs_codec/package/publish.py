"""Publishing a package: tables of the groups, full pages of the index, the MPD, and airgs.json last; and changes of it.

Each file is written whole or not at all, and nothing that airgs.json leads to is ever written twice; so a reader finds
a whole package whenever it looks, also while groups are added.

A finished folder takes the place of another. In a bucket, objects are put whole, but one by one. A package that takes
the place of another is therefore uploaded below `NEW` first, airgs.json last; from then on it is whole, and is copied
to its place inside the store. While that goes on, readers find files of both, which digests distinguish. A run that
is cut off before that has changed nothing, and the next one removes what it left; one cut off later is finished by it.
"""

from __future__ import annotations

import contextlib
import tempfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from airgs_codec.errors import ConfigError, FormatError, TransportError
from airgs_codec.package.layout import INIT_NAME, JSON_NAME, MPD_NAME, POSTER_NAME, belongs, group_path
from airgs_codec.package.manifest import Manifest, build_index, extend_index
from airgs_codec.package.mpd import LiveClock, Streams, check_mpd, still_files, write_mpd
from airgs_codec.package.package import open_manifest, open_package, read_file, root_of, write_file
from airgs_codec.package.parse import pack_group, pack_json, parse_root
from airgs_codec.package.region import levelled, unit_of, upright, world_from
from airgs_codec.package.tables import MAX_PLACES, FileEntry, Group, Place, Region, Root, Rungs
from airgs_codec.places.place import PARALLEL, Bucket, Folder, Storage, place_at
from airgs_codec.places.whole import finished_path, staged_folder, written_alone

NEW = ".new/"  # a package below it takes the place of the existing one
Ends = tuple[Sequence[float], Sequence[float]]  # (3,) a position and the point that is looked at from it


def write_tables(files: Storage, m: Manifest, clock: LiveClock | None = None) -> int:
    """Write all tables, manifest.mpd and still files of a package whose other files are written already.

    Returns the length of tables and manifest.mpd together. Raises ConfigError for a growing package without a clock,
    FormatError for tables that no reader takes.
    """
    tables = [pack_group(group) for group in m.groups]
    texts = {group_path(number): table for number, table in enumerate(tables, 1)}
    texts |= {path: pack_json(page) for path, page in build_index(m.groups, tables)[1].items()}
    checked = open_manifest(root_of(m), lambda path, _: texts[path])
    for number in checked.groups.places.sweep():
        if isinstance(number, FormatError):
            raise number
        checked.base_of(number)
    size = sum(write_file(files, path, text).bytes for path, text in texts.items())
    for path, data in still_files(m):
        write_file(files, path, data)
    return size + write_root(files, m, clock)


def write_root(files: Storage, m: Manifest, clock: LiveClock | None = None, streams: Streams | None = None) -> int:
    """Write manifest.mpd and airgs.json of a package whose tables are written; return their length together.

    `streams` as in `write_mpd`. Raises FormatError for what no reader takes; then nothing is written.
    """
    mpd, root = write_mpd(m, clock, streams), pack_json(root_of(m))
    parse_root(root)
    check_mpd(mpd, m, streams)
    return write_file(files, MPD_NAME, mpd).bytes + write_file(files, JSON_NAME, root).bytes


class GrowingPackage:
    """A package to which groups are added, until it is closed; only the newest table stays in memory."""

    def __init__(self, files: Storage, m: Manifest, available: datetime) -> None:
        """`m`: the tables of the package so far, which are written; `available`: the time of its first frame."""
        self.files = files
        self._unwritten: dict[str, bytes] = {}  # tables of the group that `expect` was called with
        self._streams, self._available = Streams.of(m), available
        self.manifest = open_manifest(root_of(m), self._read)
        self.manifest.groups.keep(len(m.groups) - 1, m.groups[-1])

    def expect(self, group: Group, rungs: Rungs | None = None) -> Manifest:
        """Return the tables with one more group, whose files are written; valid until the next call or `add`."""
        table, number = pack_group(group), len(self.manifest.groups)
        index, pages = extend_index(self.manifest.groups.columns, number, group, table)
        self._unwritten = {group_path(number + 1): table} | {path: pack_json(page) for path, page in pages.items()}
        root = replace(root_of(self.manifest), frames=group.stop, index=index)
        found = open_manifest(root if rungs is None else replace(root, rungs=rungs), self._read)
        found.groups.keep(number, group)
        return found

    def add(self, group: Group, rungs: Rungs | None = None) -> None:
        """Publish one more group, whose files are written. Raises FormatError for a table that no reader takes."""
        expected, number = self.expect(group, rungs), len(self.manifest.groups)
        open_manifest(root_of(expected), self._read).base_of(number)
        for path, data in (self._unwritten | self._streams.add(group)).items():
            write_file(self.files, path, data)
        self._unwritten = {}
        self._publish(expected)

    def close(self) -> None:
        self._publish(replace(self.manifest, live=False))

    def _read(self, path: str, entry: FileEntry) -> bytes:
        return self._unwritten[path] if path in self._unwritten else read_file(self.files, path, entry)

    def _publish(self, m: Manifest) -> None:
        self.manifest = m
        write_root(self.files, m, LiveClock(self._available, datetime.now(UTC)), self._streams)


def staged_package(place: Storage) -> AbstractContextManager[Path]:
    """Yield an empty folder of this machine; what the block leaves in it is the package at `place` when the block ends.

    Nothing changes when the block ends with an error. What runs that were cut off left is put right first. Only one run
    may write to a bucket at a time.

    Raises ConfigError where something else than a package is at the place, OSError (TransportError).
    """
    if isinstance(place, Bucket):
        return _staged_in_bucket(place)
    assert isinstance(place, Folder)
    return staged_folder(place.path, _is_package, "package")


def _is_package(folder: Path) -> bool:
    files = Folder(folder)
    try:
        parse_root(files.read(JSON_NAME) or b"")
    except FormatError:
        return False
    return all(belongs(finished_path(path)) for path in files.sizes())


@contextmanager
def _staged_in_bucket(bucket: Bucket) -> Iterator[Path]:
    """Try before the block that objects can be put, copied and deleted."""
    _put_right(bucket)
    one, other = NEW + MPD_NAME, NEW + INIT_NAME
    write_file(bucket, one, b"airgs")
    bucket.copy(one, other)
    bucket.delete([one, other])
    with tempfile.TemporaryDirectory(prefix="airgs-") as folder:
        yield Path(folder)
        _upload(Folder(Path(folder)), bucket)


def _put_right(bucket: Bucket) -> None:
    found = bucket.paths()
    if foreign := [name for name in found if not belongs(name.removeprefix(NEW))]:
        raise ConfigError(f"{bucket.name}: expected a new prefix or an existing package, found {foreign[0]}")
    if NEW + JSON_NAME in found:
        _take_place(bucket)
    else:
        bucket.delete(name for name in found if name.startswith(NEW))


def _upload(folder: Folder, bucket: Bucket) -> None:
    names, before = folder.paths(), bucket.paths()
    place = NEW if JSON_NAME in before else ""
    try:
        _for_each(names, lambda name: write_file(bucket, place + name, (folder.path / name).read_bytes()))
    except BaseException:
        with contextlib.suppress(TransportError):
            bucket.delete(place + name for name in names)
        raise
    if place:
        _take_place(bucket)
    else:
        bucket.delete(set(before) - set(names))


def _take_place(bucket: Bucket) -> None:
    """Copy the package below `NEW` to its place; what is left of the old one goes. May be repeated at any time."""
    found = bucket.paths()
    names = [name.removeprefix(NEW) for name in found if name.startswith(NEW)]
    try:
        _for_each(names, lambda name: bucket.copy(NEW + name, name))
    except TransportError as error:
        words = f"the new package is whole below {NEW}, and the next run that writes here puts it in its place"
        raise TransportError(f"{error}; {words}") from error
    bucket.delete(name for name in found if name not in names and not name.startswith(NEW))
    bucket.delete([NEW + JSON_NAME])  # first: without it, what is below `NEW` is no package
    bucket.delete(NEW + name for name in names if name != JSON_NAME)


def _for_each(names: Iterable[str], work: Callable[[str], object]) -> None:
    """Work on the files of a package: on many at a time, on manifest.mpd after them, on airgs.json last."""
    roots = [name for name in (MPD_NAME, JSON_NAME) if name in names]
    with ThreadPoolExecutor(PARALLEL) as pool:
        list(pool.map(work, [name for name in names if name not in roots]))
    for name in roots:
        work(name)


def set_view(
    path: str | Path, *, up: Sequence[float] | None = None, view: Ends | None = None, name: str | None = None
) -> Root:
    """Change the package at `path`, whole or not at all, and return what is written.

    `up` (3,) is up from now on. `view` is a position and the point looked at, (3,) each: viewers begin there, or, with
    a `name`, find it under that name, instead of what had it before; they may go as far from it as from the place next
    to it. A poster shows what was the first view, so it goes where that changes. Whoever else changes a package in a
    folder at this moment is waited for.

    Raises ConfigError for nothing to change or a package that is still growing, FormatError for values that no reader
    takes, OSError where nothing can be written.
    """
    if up is None and view is None:
        raise ConfigError(f"{path}: expected a way up or a view, got nothing to change")
    place = place_at(path)
    with written_alone(place.path) if isinstance(place, Folder) and place.path.is_dir() else nullcontext():
        package = open_package(path)
        root = root_of(package.manifest)
        if root.live:
            raise ConfigError(f"{path}: expected a package that is whole, got one that is still growing")
        if up is not None:
            root = replace(root, world=world_from(up, unit_of(root.world) if root.world else None))
        if view is not None:
            if not np.isfinite(view).all():
                raise ConfigError(f"view: expected finite numbers, got {view[0]} and {view[1]}")
            root = replace(root, region=_with_view(root, view, name))
        if up is not None or name is None:
            root = replace(root, poster=None)
        text = pack_json(root)
        parse_root(text)
        write_file(package.files, JSON_NAME, text)
        if root.poster is None:  # a run that was killed here may have left it
            package.files.delete([POSTER_NAME])
    return root


def _with_view(root: Root, view: Ends, name: str | None) -> Region:
    position, focus = (list(map(float, point)) for point in view)
    region = levelled(root.region, root.world)
    away = [float(np.linalg.norm(np.subtract(place.position, position))) for place in region.places]
    reach = region.places[int(np.argmin(away))].reach
    place = Place(position, focus, upright(region).tolist(), reach, name)
    others = [other for other in root.region.places if name is None or other.name != name]
    if len(others) == MAX_PLACES:
        raise ConfigError(f"region: expected at most {MAX_PLACES} places, got one more")
    return replace(root.region, places=[place, *others] if name is None else [*others, place])
