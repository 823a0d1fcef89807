"""Live publishing for a while: what a late viewer fetches and what a publisher keeps do not depend on how long."""

import csv
import json

import pytest

from airgs_codec.package.tables import PAGE
from tests.support.scenes import moving_frames, write_sequence
from tools import soak_live


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """The rows of 200 s and four viewers, and the folder of the results."""
    out = tmp_path_factory.mktemp("soak")
    scene = write_sequence(out / "scene", moving_frames(150, 5))
    assert soak_live.main(["-o", str(out), "--scene", str(scene), "--hours", str(200 / 3600), "--joiners", "4"]) == 0
    return list(csv.DictReader((out / "soak.csv").read_text().splitlines())), out


def test_a_late_viewer_fetches_as_much_as_an_early_one(run):
    rows, out = run
    assert len(rows) == 4 and rows[-1]["groups"] == "200"
    assert {row["requests"] for row in rows} == {rows[0]["requests"]}
    for row in rows:  # the groups after the last page, and an entry for each page
        listed = int(row["groups"]) % PAGE + int(row["groups"]) // PAGE
        assert abs(int(row["start"]) - int(rows[0]["start"])) < 64 * (PAGE + 3)
        assert int(row["tables"]) < int(row["start"]) and int(row["root"]) < 4000 + 64 * listed
    assert len({row["mpd"] for row in rows[1:]}) == 1
    assert (out / "soak.png").stat().st_size and json.loads((out / "soak.json").read_text())["last"]["groups"] == 200


def test_settings_that_cannot_work_are_refused(tmp_path, capsys):
    assert soak_live.main(["-o", str(tmp_path), "--hours", "0"]) == 2
    assert "expected at least 2 s" in capsys.readouterr().err
