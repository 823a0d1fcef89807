"""A package is written whole or not at all: into a bucket, group after group, and where viewers begin is changed."""

import itertools
import shutil
from dataclasses import replace
from datetime import UTC, datetime

import pytest
from obstore.exceptions import GenericError
from obstore.store import MemoryStore

from tests import faces
from tests.faces import JSON_NAME, MPD_NAME, Bucket, ConfigError, Folder, FormatError, TransportError, open_package
from tests.support.growing import PAGED
from tests.support.mutations import read_files
from tests.support.paths import VALID

OLD, OTHER = VALID / "two-groups-sh1", VALID / "moving"


class FailingStore:
    """A store that refuses to change after so many changes, once or from then on."""

    def __init__(self, store, changes, for_good):
        self._store, self._left, self._for_good = store, changes, for_good
        self.log = []

    def __getattr__(self, name):
        call = getattr(self._store, name)

        def change(*args, **more):
            self._left -= 1
            if self._left == -1 or (self._for_good and self._left < 0):
                raise GenericError("the store has gone away")
            self.log.append((name, args[-1] if name == "copy" else args[0]))
            return call(*args, **more)

        return change if name in ("put", "copy", "delete") else call


def files(store):
    bucket = Bucket("memory", store)
    return {name: bucket.read(name) for name in bucket.paths()}


def stage(store):
    return faces.staged_package(Bucket("memory", store))


def publish(store, package):
    with stage(store) as folder:
        shutil.copytree(package, folder, dirs_exist_ok=True)


def store_with(before):
    store = MemoryStore()
    if before:
        publish(store, before)
    return store


@pytest.fixture(params=[None, OLD], ids=["new", "replaced"])
def before(request):
    return request.param


def test_nothing_but_the_package_is_there_and_airgs_json_is_written_last_before_the_old_goes(before):
    store = store_with(before)
    spy = FailingStore(store, 10**6, False)
    publish(spy, OTHER)
    assert files(store) == read_files(OTHER)
    written = [name for what, name in spy.log if what != "delete" and not name.startswith(".new/")]
    assert written[-2:] == [MPD_NAME, JSON_NAME] and len(written) == len(read_files(OTHER))
    deleted = [names for what, names in spy.log[spy.log.index(("copy" if before else "put", JSON_NAME)) :]][1:]
    gone = set(read_files(OLD)) - set(read_files(OTHER)) if before else set()
    assert gone <= {name for names in deleted for name in names}


@pytest.mark.parametrize("for_good", [False, True], ids=["once", "for good"])
def test_a_failure_at_any_moment_leaves_the_old_package_or_the_new_one(before, for_good):
    new, outcomes = read_files(OTHER), []  # what is there once the next run has put right what a failure left
    for changes in itertools.count():
        store = store_with(before)
        try:
            publish(FailingStore(store, changes, for_good), OTHER)
            break
        except TransportError:
            with pytest.raises(KeyboardInterrupt), stage(store):
                raise KeyboardInterrupt from None
        found = files(store)
        outcomes.append("new" if found == new else "old")
        if before or JSON_NAME in found:  # else what was cut off is no package; the next one takes its place
            assert found in (read_files(before) if before else {}, new)
    assert files(store) == new and len(outcomes) >= len(new)
    assert set(outcomes) == ({"old", "new"} if before else {"old"})


def test_what_is_cut_off_while_it_takes_its_place_is_said():
    with pytest.raises(TransportError, match=r"whole below \.new/, and the next run"):
        publish(FailingStore(store_with(OLD), 3 + len(read_files(OTHER)) + 5, True), OTHER)


def test_an_error_of_the_writer_or_of_one_upload_changes_nothing(before):
    store = store_with(before)
    with pytest.raises(RuntimeError), stage(store) as folder:
        shutil.copytree(OTHER, folder, dirs_exist_ok=True)
        raise RuntimeError
    assert files(store) == (read_files(before) if before else {})
    with pytest.raises(TransportError, match=r"^memory/\S+: the store has gone away$"):
        publish(FailingStore(store, 12, False), OTHER)
    assert files(store) == (read_files(before) if before else {})


@pytest.mark.parametrize("name", ["thesis.tex", "other.airgs/airgs.json", ".new/thesis.tex"])
def test_foreign_objects_are_never_touched(before, name):
    store = store_with(before)
    store.put(name, b"years of work")
    there = files(store)
    with pytest.raises(ConfigError, match=name), stage(store):
        raise AssertionError("unreachable")
    assert files(store) == there


def test_players_are_told_what_files_are_and_reading_checks_as_on_disk():
    store, fresh = store_with(OLD), {"Cache-Control": "no-cache"}
    publish(store, OTHER)
    for name, told in {
        JSON_NAME: {"Content-Type": "application/json"} | fresh,
        MPD_NAME: {"Content-Type": "application/dash+xml"} | fresh,
        "init.mp4": {"Content-Type": "video/mp4"},
        "group/1.json.gz": {"Content-Type": "application/gzip"},
    }.items():
        assert store.get(name).attributes == told
    package = faces.open_files(Bucket("memory", store))
    assert package.mpd_bytes == (OTHER / MPD_NAME).stat().st_size
    assert package.read("keyframe/T0/1.bin") == (OTHER / "keyframe/T0/1.bin").read_bytes()
    store.delete("keyframe/T0/1.bin")
    with pytest.raises(FormatError, match="missing_file"):
        package.read("keyframe/T0/1.bin")


@pytest.fixture(scope="module")
def whole():
    return open_package(PAGED).manifest


@pytest.fixture
def growing(whole, tmp_path):
    folder, now = Folder(tmp_path), datetime(2026, 1, 1, tzinfo=UTC)
    for name, data in read_files(PAGED).items():
        if name.startswith(("keyframe/", "delta/", "init")):
            folder.write(name, data)
    m = replace(whole, live=True, frames=whole.groups[0].stop, groups=faces.Groups.of(whole.groups[:1]))
    faces.write_tables(folder, m, faces.LiveClock(now, now))
    return faces.GrowingPackage(folder, m, now)


def test_a_package_that_grows_ends_as_if_written_at_once_and_keeps_few_tables_in_memory(whole, growing, tmp_path):
    for group in whole.groups[1:63]:
        growing.add(group)
    before = read_files(tmp_path)
    expected = growing.expect(whole.groups[63])  # it fills the page, and nothing is written
    assert [expected.groups[i] for i in (0, 63)] == [whole.groups[i] for i in (0, 63)]
    assert expected.frames == whole.groups[63].stop and read_files(tmp_path) == before
    growing.add(whole.groups[63])
    assert faces.root_of(growing.manifest) == faces.root_of(expected) == faces.root_of(open_package(tmp_path).manifest)
    growing.add(whole.groups[64])
    assert len(growing.manifest.groups._known) <= 2  # tables are read again where they are wanted
    growing.close()
    assert faces.validate(tmp_path) == []
    assert read_files(tmp_path) == read_files(PAGED)
    assert growing.manifest.groups[3] == whole.groups[3] and len(growing.manifest.segments) == len(whole.segments)


def test_what_no_reader_takes_is_not_written(whole, growing, tmp_path):
    before = read_files(tmp_path)
    with pytest.raises(FormatError, match=r"group/2\.json\.gz"):
        growing.add(replace(whole.groups[1], static=-1))
    with pytest.raises(FormatError, match="fov_y"):
        faces.write_root(Folder(tmp_path), replace(whole, region=replace(whole.region, fov_y=179.99)))
    assert read_files(tmp_path) == before and len(growing.manifest.groups) == 1


@pytest.fixture
def placed(tmp_path):
    return shutil.copytree(VALID / "placed", tmp_path / "placed.airgs")


def test_viewers_begin_where_they_are_told_to_and_nothing_else_changes(placed):
    before, places = read_files(placed), open_package(placed).manifest.region.places
    view = ["--position=-1,2,3.5", "--look-at", "0,0,1", "--up", "-y"]
    assert faces.airgs_manifest(["set-view", str(placed), *view]) == 0
    after, m = read_files(placed), open_package(placed).manifest
    first = m.region.places[0]
    assert (first.position, first.focus, first.name) == ([-1, 2, 3.5], [0, 0, 1], None)
    assert first.reach in [place.reach for place in places] and m.region.places[1:] == places
    assert faces.up_of(m.world).tolist() == [0, -1, 0] == first.up
    assert m.world.metric and m.world.transform[4:7] == pytest.approx([0, -0.01, 0])  # a unit is as long as before
    assert m.poster is None and not (placed / "poster.jpg").exists()
    assert {name for name in before if before[name] != after.get(name)} <= {"airgs.json", "poster.jpg"}
    assert faces.validate(placed) == []


def test_a_named_view_is_found_by_its_name_and_the_first_place_stays(placed, capsys):
    places, poster = open_package(placed).manifest.region.places, open_package(placed).manifest.poster
    faces.set_view(placed, view=((1, 1, 1), (0, 0, 0)), name="from above")
    view = ["--position", "2,2,2", "--look-at", "0,0,0", "--name", "from above"]
    faces.airgs_manifest(["set-view", str(placed), *view])
    m = open_package(placed).manifest
    assert m.region.places[:-1] == places and m.poster == poster
    assert (m.region.places[-1].name, m.region.places[-1].position) == ("from above", [2, 2, 2])
    assert "named views: from above" in capsys.readouterr().out and faces.validate(placed) == []


@pytest.mark.parametrize(("change", "error", "words"), [
    ({}, ConfigError, "nothing to change"),
    ({"up": (0, 0, 0)}, ConfigError, "up: expected a direction"),
    ({"view": ((1, 1, 1), (1, 1, 1))}, FormatError, "focus: expected other than"),
    ({"view": ((1, 1, float("nan")), (1, 1, 1))}, ConfigError, "view: expected finite numbers"),
    ({"view": ((1, 1, 1), (0, 0, 0)), "name": 65 * "a"}, FormatError, "name: expected 1 to 64 characters"),
])  # fmt: skip
def test_a_view_that_no_reader_takes_changes_nothing(placed, change, error, words):
    before = read_files(placed)
    with pytest.raises(error, match=words):
        faces.set_view(placed, **change)
    assert read_files(placed) == before


def test_places_run_out(placed):
    for i in range(64 - len(open_package(placed).manifest.region.places)):
        faces.set_view(placed, view=((1, 1, i), (0, 0, -1)), name=str(i))
    with pytest.raises(ConfigError, match="at most 64 places"):
        faces.set_view(placed, view=((1, 1, 1), (0, 0, 0)))


@pytest.mark.parametrize(("words", "named"), [
    *((words, "--look-at") for words in ("--position 1,2,3", "--up y --name x")),
    ("--position 1,2", "position"),
    *((f"--up={text}", "up") for text in ("up", "1,2", "0,0,0", "nan,0,1", "1,inf,0", "")),
])  # fmt: skip
def test_options_that_say_half_or_no_direction_are_refused(placed, words, named, capsys):
    before = read_files(placed)
    assert faces.airgs_manifest(["set-view", str(placed), *words.split()]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1 and named in said and read_files(placed) == before
