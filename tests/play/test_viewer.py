"""Where the viewer of a session stands: inside the region, or he says by how much not."""

import dataclasses
import json

import numpy as np
import pytest

from airgs_codec._report import new_figure
from airgs_codec.package.region import place_view
from airgs_codec.play.offers import Offers
from airgs_codec.play.report.map import MOST_PIXELS, Viewer, draw_walk
from airgs_codec.play.report.session import format_metrics, write_report
from airgs_codec.play.session import simulate
from airgs_codec.play.settings import SessionSettings
from airgs_codec.play.trace import Trace
from tests.support.manifests import tiny_manifest
from tests.support.regions import arc, row


def session(region):
    m = dataclasses.replace(tiny_manifest(), region=region)
    return simulate(Offers(m, 0, 1000), Trace.open("const:9"), "fixed:0", SessionSettings(loops=2))


def test_a_viewer_in_the_region_has_nothing_to_say():
    log = session(arc(180, 7, 0.9))
    viewer = Viewer.of(log)
    assert len(viewer.cameras) == len(log.screen_ticks) == 40 and viewer.outside == 0
    assert {viewer.caption(tick) for tick in range(40)} == {""}
    assert viewer.words == "inside the viewing region all the time"
    assert all((camera.width, camera.height) == (32, 24) for camera in viewer.cameras)


def test_who_leaves_the_region_says_by_how_much(tmp_path):
    """A camera two units to the side of a ball of one unit, which looks 20 degrees more aside than it may."""
    region = row(1, 1.0)
    place = region.places[0]
    turned = 10 * np.tan(np.radians(30))
    aside = place_view(region, dataclasses.replace(place, position=[0.0, 3.0, 0.0], focus=[turned, 3.0, 10.0]))
    log = session(region)
    viewer = Viewer.of(log, [aside])
    assert viewer.outside == 40
    assert viewer.furthest.distance == pytest.approx(2) and viewer.furthest.degrees > 15
    assert viewer.caption(0).startswith("outside the region: 2 units and ") and viewer.caption(0).endswith("°")
    assert "outside the viewing region for 40 of 40 ticks" in format_metrics(log, viewer)
    page = write_report(log, tmp_path, viewer)
    record = json.loads((tmp_path / "session.json").read_text())
    assert record["viewer"]["ticks_outside"] == 40 and record["viewer"]["furthest_units"] == pytest.approx(2)
    text = page.read_text()
    assert "outside the viewing region for 40 of 40" in text and "The viewing region from above" in text
    axis = new_figure(4, 3).subplots()
    draw_walk(viewer, axis)
    drawn = {line.get_label(): line.get_xydata() for line in axis.lines}
    assert len(axis.patches) == len(region.places) and len(drawn["looked at"]) == len(region.places)
    assert len(drawn["the walk"]) == 40
    np.testing.assert_array_equal(drawn["outside"], drawn["the walk"])
    above = np.tile(
        drawn["places, and their reach"][:1], (40, 1)
    )  # he is to the side along up, as seen from above there
    np.testing.assert_allclose(drawn["outside"], above, atol=1e-6)


def test_a_guessed_region_is_told_in_every_picture():
    viewer = Viewer.of(session(dataclasses.replace(arc(180, 7, 0.9), source="orbit")))
    assert {viewer.caption(tick) for tick in range(40)} == {"viewpoint unknown: an orbit is assumed"}


def test_stops_behind_the_content_are_counted():
    region = arc(180, 2, 0.5)
    viewer = Viewer.of(session(region), [place_view(region, place) for place in region.places])
    assert viewer.unreached == viewer.table()["stops_unreached"] == 1 and viewer.words.endswith("looked at: 1")


def test_pictures_of_the_screen_have_a_bound():
    viewer = Viewer.of(session(dataclasses.replace(row(1, 1.0), width=1500, height=3000)))
    assert {(camera.width, camera.height) for camera in viewer.cameras} == {(MOST_PIXELS // 2, MOST_PIXELS)}


def test_the_report_has_the_region_and_what_the_package_claims(tmp_path):
    log = session(arc(180, 7, 0.9))
    page = write_report(log, tmp_path).read_text()
    record = json.loads((tmp_path / "session.json").read_text())
    assert record["viewer"] is None and record["region"]["places"] == 7
    told = {"rung": "Q0+L0", "psnr": pytest.approx(40), "worst": 38, "shown": 4, "on_ladder": True}
    assert record["rungs"][0] == {**told, "mbps": pytest.approx(8 * 6300 / 1e6)}
    assert "7 places with a reach of 0.9 units" in page and "<td>38.00 dB</td>" in page
