"""A package in an object store: whole or not there, whatever happens while it is written."""

import shutil

import pytest
from obstore.exceptions import GenericError
from obstore.store import MemoryStore

from airgs_codec.package.package import find_file
from airgs_codec.package.publish import NEW
from airgs_codec.places.place import Bucket
from tests.faces import JSON_NAME, MPD_NAME, ConfigError, FormatError, TransportError, staged_package
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
        return self._counted(name, call) if name in ("put", "copy", "delete") else call

    def _counted(self, name, call):
        def change(*args, **more):
            self._left -= 1
            if self._left == -1 or (self._for_good and self._left < 0):
                raise GenericError("the store has gone away")
            self.log.append((name, args[-1] if name == "copy" else args[0]))
            return call(*args, **more)

        return change


def files(store):
    bucket = Bucket("memory", store)
    return {name: bucket.read(name) for name in bucket.paths()}


def publish(store, package):
    with staged_package(Bucket("memory", store)) as stage:
        shutil.copytree(package, stage, dirs_exist_ok=True)


@pytest.fixture(params=[None, OLD], ids=["new", "replaced"])
def before(request):
    """What is at the place before: nothing or a package."""
    return request.param


@pytest.fixture
def store(before):
    store = MemoryStore()
    if before:
        publish(store, before)
    return store


def test_nothing_but_the_package_is_there(store):
    publish(store, OTHER)
    assert files(store) == read_files(OTHER)


def test_airgs_json_is_written_last_and_the_old_goes_after_it(store, before):
    spy = FailingStore(store, 10**6, False)
    publish(spy, OTHER)
    written = [name for what, name in spy.log if what != "delete" and not name.startswith(NEW)]
    assert written[-2:] == [MPD_NAME, JSON_NAME] and len(written) == len(read_files(OTHER))
    deleted = [names for what, names in spy.log[spy.log.index(("copy" if before else "put", JSON_NAME)) :]][1:]
    gone = set(read_files(OLD)) - set(read_files(OTHER)) if before else set()
    assert gone <= {name for names in deleted for name in names}


@pytest.mark.parametrize("for_good", [False, True], ids=["once", "for good"])
def test_a_failure_at_any_moment_leaves_the_old_package_or_the_new_one(before, for_good):
    changes, outcomes = 0, []
    while not outcomes or outcomes[-1] != "done":
        store = MemoryStore()
        if before:
            publish(store, before)
        outcomes.append(_outcome(store, FailingStore(store, changes, for_good), before))
        changes += 1
    assert {"old", "done"} <= set(outcomes) and len(outcomes) > len(read_files(OTHER))
    assert ("new" in outcomes) == (before is not None)


def _outcome(store, failing, before):
    """`old` or `new`: what is there once the next run has put right what a failure left; `done` without a failure."""
    try:
        publish(failing, OTHER)
    except TransportError:
        with pytest.raises(KeyboardInterrupt), staged_package(Bucket("memory", store)):
            raise KeyboardInterrupt from None
        found = files(store)
        if not before and JSON_NAME not in found:  # what was cut off is no package; the next one takes its place
            return "old"
        assert found in (read_files(before) if before else {}, read_files(OTHER))
        return "new" if found == read_files(OTHER) else "old"
    assert files(store) == read_files(OTHER)
    return "done"


def test_what_is_cut_off_while_it_takes_its_place_is_said():
    store = MemoryStore()
    publish(store, OLD)
    with pytest.raises(TransportError, match=r"whole below \.new/, and the next run"):
        publish(FailingStore(store, 3 + len(read_files(OTHER)) + 5, True), OTHER)


def test_an_error_of_the_writer_changes_nothing(store, before):
    with pytest.raises(RuntimeError), staged_package(Bucket("memory", store)) as stage:
        shutil.copytree(OTHER, stage, dirs_exist_ok=True)
        raise RuntimeError
    assert files(store) == (read_files(before) if before else {})


def test_an_upload_that_fails_once_leaves_nothing_behind(store, before):
    failing = FailingStore(store, 12, False)
    with pytest.raises(TransportError, match=r"^memory/\S+: the store has gone away$"):
        publish(failing, OTHER)
    assert files(store) == (read_files(before) if before else {})


@pytest.mark.parametrize("name", ["thesis.tex", "other.airgs/airgs.json", ".new/thesis.tex"])
def test_foreign_objects_are_never_touched(store, name):
    store.put(name, b"years of work")
    before = files(store)
    with pytest.raises(ConfigError, match=name), staged_package(Bucket("memory", store)):
        raise AssertionError("unreachable")
    assert files(store) == before


def test_players_are_told_what_files_are():
    store = MemoryStore()
    publish(store, OLD)
    publish(store, OTHER)
    told = {name: store.get(name).attributes for name in (JSON_NAME, MPD_NAME, "init.mp4", "group/1.json.gz")}
    assert told[JSON_NAME] == {"Content-Type": "application/json", "Cache-Control": "no-cache"}
    assert told[MPD_NAME] == {"Content-Type": "application/dash+xml", "Cache-Control": "no-cache"}
    assert told["init.mp4"] == {"Content-Type": "video/mp4"}
    assert told["group/1.json.gz"] == {"Content-Type": "application/gzip"}


def test_reading_checks_as_on_disk():
    store = MemoryStore()
    publish(store, OLD)
    bucket = Bucket("memory", store)
    size, read = find_file(bucket, MPD_NAME)
    assert size == len(read()) == (OLD / MPD_NAME).stat().st_size
    with pytest.raises(FormatError, match="missing_file"):
        find_file(bucket, "key/T0/99.bin")
