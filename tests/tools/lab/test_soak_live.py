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
    (section,), (table,) = page.sections, page.tables()
    rows = table.rows
    assert len(rows) == 4 and rows[-1]["groups"] == 200
    assert {row["requests"] for row in rows} == {rows[0]["requests"]}
    for row in rows:  # the groups after the last page, and an entry for each page
        listed = row["groups"] % PAGE + row["groups"] // PAGE
        assert abs(row["start_bytes"] - rows[0]["start_bytes"]) < 64 * (PAGE + 3)
        assert row["table_bytes"] < row["start_bytes"] and row["root_bytes"] < 4000 + 64 * listed
    assert len({row["mpd_bytes"] for row in rows[1:]}) == 1
    write_picture(section.pictures[0], tmp_path / "soak.png")
    assert (tmp_path / "soak.png").stat().st_size


def test_what_grows_is_told_from_what_does_not():
    def moment(hour, start, memory, ms):
        return live.Moment(hour, 10, 1, 1, 7, 1, start, memory, ms)

    still = [moment(hour, 50_000 + 100 * hour, 300.0, 1.5) for hour in range(8)]
    assert live.words(still) == (
        "From the second quarter of the time to the last, what a viewer fetches before the first picture (50.2 to 50.6 "
        "kB), the memory of the publisher (300 to 300 MB) and its CPU time for a group (1.5 to 1.5 ms) do not grow."
    )
    grown = [moment(hour, 50_000, 100.0 + 30 * hour, 1.5) for hour in range(8)]
    assert "the memory of the publisher (175 to 295 MB) grows; what" in live.words(grown)
    assert live.words(still[:1])


def test_settings_that_cannot_work_are_refused(tmp_path):
    with pytest.raises(ConfigError, match="expected at least 2 s"):
        live.run(live.Options(hours=0), Lab.at(tmp_path))
