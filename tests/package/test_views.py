"""Where viewers begin, up and named views are changed in airgs.json alone, whole or not at all."""

import shutil

import pytest

from tests.faces import MAX_PLACES, ConfigError, FormatError, airgs_manifest, open_package, set_view, up_of, validate
from tests.support.paths import VALID


@pytest.fixture
def package(tmp_path):
    return shutil.copytree(VALID / "placed", tmp_path / "placed.airgs")


def bytes_of(folder):
    return {path.relative_to(folder): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_viewers_begin_where_they_are_told_to_and_nothing_else_changes(package):
    before, places = bytes_of(package), open_package(package).manifest.region.places
    view = ["--position=-1,2,3.5", "--look-at", "0,0,1"]
    assert airgs_manifest(["set-view", str(package), *view, "--up", "-y"]) == 0
    after, m = bytes_of(package), open_package(package).manifest
    first = m.region.places[0]
    assert (first.position, first.focus, first.name) == ([-1, 2, 3.5], [0, 0, 1], None)
    assert first.reach in [place.reach for place in places] and m.region.places[1:] == places
    assert up_of(m.world).tolist() == [0, -1, 0] == first.up and m.world.metric
    assert m.poster is None and not (package / "poster.jpg").exists()
    assert {str(path) for path in before if before[path] != after.get(path)} <= {"airgs.json", "poster.jpg"}
    assert validate(package) == []


def test_a_named_view_is_found_by_its_name_and_the_first_place_stays(package, capsys):
    places, poster = open_package(package).manifest.region.places, open_package(package).manifest.poster
    set_view(package, view=((1, 1, 1), (0, 0, 0)), name="from above")
    airgs_manifest(["set-view", str(package), "--position", "2,2,2", "--look-at", "0,0,0", "--name", "from above"])
    m = open_package(package).manifest
    assert m.region.places[:-1] == places and m.poster == poster
    assert (m.region.places[-1].name, m.region.places[-1].position) == ("from above", [2, 2, 2])
    assert "named views: from above" in capsys.readouterr().out and validate(package) == []


@pytest.mark.parametrize(
    ("change", "error", "words"),
    [
        ({}, ConfigError, "nothing to change"),
        ({"up": (0, 0, 0)}, ConfigError, "up: expected a direction"),
        ({"view": ((1, 1, 1), (1, 1, 1))}, FormatError, "focus: expected other than"),
        ({"view": ((1, 1, float("nan")), (1, 1, 1))}, ConfigError, "view: expected finite numbers"),
        ({"view": ((1, 1, 1), (0, 0, 0)), "name": 65 * "a"}, FormatError, "name: expected 1 to 64 characters"),
    ],
)
def test_what_no_reader_takes_changes_nothing(package, change, error, words):
    before = bytes_of(package)
    with pytest.raises(error, match=words):
        set_view(package, **change)
    assert bytes_of(package) == before


def test_places_run_out(package):
    for i in range(MAX_PLACES - len(open_package(package).manifest.region.places)):
        set_view(package, view=((1, 1, i), (0, 0, -1)), name=str(i))
    with pytest.raises(ConfigError, match=f"at most {MAX_PLACES} places"):
        set_view(package, view=((1, 1, 1), (0, 0, 0)))


@pytest.mark.parametrize("words", [["--position", "1,2,3"], ["--up", "y", "--name", "x"], ["--position", "1,2"]])
def test_options_that_say_half_are_refused(package, words, capsys):
    assert airgs_manifest(["set-view", str(package), *words]) == 2
    assert capsys.readouterr().err.count("\n") == 1
