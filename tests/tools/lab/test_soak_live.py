"""Live publishing for a while: what a late viewer fetches and what a publisher keeps do not depend on how long."""

import pytest

from airgs_codec.errors import ConfigError
from airgs_codec.package.tables import PAGE
from tests.support.scenes import moving_frames, write_sequence
from tools.lab.command import Lab
from tools.lab.page import write_picture
from tools.lab.soak import live


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    """200 s and four viewers."""
    out = tmp_path_factory.mktemp("soak")
    scene = write_sequence(out / "scene", moving_frames(150, 5))
    return live.run(live.Options(hours=200 / 3600, joiners=4, scene=scene), Lab.at(out / "out"))


def test_a_late_viewer_fetches_as_much_as_an_early_one(page, tmp_path):
    (section,) = page.sections
    rows = section.tables[0].rows
    assert len(rows) == 4 and rows[-1]["groups"] == 200
    assert {row["requests"] for row in rows} == {rows[0]["requests"]}
    for row in rows:  # the groups after the last page, and an entry for each page
        listed = row["groups"] % PAGE + row["groups"] // PAGE
        assert abs(row["start_bytes"] - rows[0]["start_bytes"]) < 64 * (PAGE + 3)
        assert row["table_bytes"] < row["start_bytes"] and row["root_bytes"] < 4000 + 64 * listed
    assert len({row["mpd_bytes"] for row in rows[1:]}) == 1
    write_picture(section.pictures[0], tmp_path / "soak.png")
    assert (tmp_path / "soak.png").stat().st_size


def test_settings_that_cannot_work_are_refused(tmp_path):
    with pytest.raises(ConfigError, match="expected at least 2 s"):
        live.run(live.Options(hours=0), Lab.at(tmp_path))
