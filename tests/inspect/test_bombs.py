"""Small files that promise far more than they have: what they may cost is known before anything is built or counted."""

import pytest

from tests.faces import PAGE, airgs_manifest, airgs_play, find_faults, open_package, validate
from tests.support.mutations import apply, read_files, set_value, write_files
from tests.support.paths import VALID

MANY = PAGE**4
EMPTY = {"frames": [], "segments": [], "bytes": [], "sha256": ""}
BOMB = {"frames": [MANY], "segments": [MANY], "bytes": [100], "sha256": "A" * 32}
PAGE_PATH = "index/4/1.json"


@pytest.fixture
def bomb(tmp_path):
    """A package of 16 million groups, of which airgs.json is all there is."""
    changes = [set_value(("index",), [EMPTY] * 4 + [BOMB]), set_value(("frames",), MANY)]
    write_files(tmp_path / "bomb", apply(read_files(VALID / "moving"), *changes))
    return tmp_path / "bomb"


def test_groups_that_no_page_leads_to_are_not_looked_for(bomb):
    (finding,) = validate(bomb)
    assert (finding.reason, finding.where) == ("missing_file", PAGE_PATH)
    assert list(find_faults(open_package(bomb))) == [PAGE_PATH]


def test_commands_say_so_in_a_line(bomb, capsys):
    assert airgs_manifest(["inspect", str(bomb)]) == 2
    assert PAGE_PATH in (said := capsys.readouterr().err) and said.count("\n") == 1


def test_a_session_ends_when_nothing_can_be_shown_for_long(bomb, tmp_path, capsys):
    assert airgs_play([str(bomb), "--trace", "const:8", "--json"]) == 0
    said = capsys.readouterr().out
    assert "1000 segments in a row were lost" in said
    assert airgs_play([str(bomb), "--trace", "const:8", "--report", str(tmp_path / "report")]) == 2
    assert len(capsys.readouterr().err) < 1000


def test_text_of_a_package_does_not_act_on_a_terminal(tmp_path, capsys):
    evil = "\x1b[2J\x9b2J\u202eby a friend"
    write_files(tmp_path / "p", apply(read_files(VALID / "moving"), set_value(("attribution",), evil)))
    assert airgs_manifest(["inspect", str(tmp_path / "p")]) == 0
    said = capsys.readouterr().out
    assert r"\x1b[2J\x9b2J\u202eby a friend" in said and all(c.isprintable() or c == "\n" for c in said)
