"""<airgs-player> with a player that pretends, driven by a mouse, fingers and keys (web/test/support/ui-cases.ts)."""

import numpy as np
import pytest

from tests.support.browser import WEB, Answer, build_pages, missing, serve, visit_all
from tests.support.page import look, script_page

FIRST = np.array([0, -0.6, -4])  # of the pretended region, which looks at 0
REACH = 1.2
AWAY = float(np.linalg.norm(FIRST))
GIVES = 0.15 * AWAY  # the most that the wall does

PAGES = (  # cases that follow each other; after those at an end, timers, touches or the address are not as they were
    *("keys,sound,menu,hide", "wall,names,scrub,life,touch"),
    *("drag,split,trouble", "wheel,path,live,address"),
)

pytestmark = pytest.mark.skipif(bool(missing()), reason=f"not here: {', '.join(missing())}")


@pytest.fixture(scope="module")
def report():
    """Case of web/test/support/ui-cases.ts -> what came of it; the pages must not have complained."""
    build_pages()
    with serve({"web": WEB}, {"/ui.html": script_page("ui")}) as site:
        visits = visit_all([(f"{site.url}/ui.html?cases={cases}", "") for cases in PAGES])
    assert [seen.complaints() for seen in visits] == [[]] * len(PAGES)
    return {case: came for seen in visits for case, came in seen.report.items()}


def azimuth(camera):
    """Degrees that a camera has gone round the focus, to the right."""
    return np.degrees(np.arctan2(camera["position"][0], -camera["position"][2]))


def away(camera, place=(0, 0, 0)):
    return float(np.linalg.norm(np.subtract(camera["position"], place)))


def test_a_drag_turns_with_shift_it_moves_and_a_double_click_goes_back(report):
    seen = report["drag"]
    assert seen["first"]["position"] == FIRST.tolist()
    assert azimuth(seen["turned"]) < -5  # the scene goes to the right with the hand
    assert away(seen["turned"]) == pytest.approx(away(seen["first"]), rel=1e-6)
    step = np.subtract(seen["moved"]["position"], seen["turned"]["position"])
    assert step @ np.array(seen["turned"]["up"]) > 0.1
    assert seen["last"]["position"] == pytest.approx(FIRST.tolist(), abs=1e-6)
    assert seen["paused"]  # neither a drag nor a double click plays


def test_the_camera_goes_along_a_path_until_it_is_touched(report):
    seen = report["path"]
    assert seen["first"]["position"] == pytest.approx([0.2, -0.6, -4]) and seen["first"]["fovY"] == 30
    assert seen["gone"]["position"][0] > 0.2 and not seen["paused"]
    assert seen["camera"]["position"] == FIRST.tolist() and "camera path cannot be used" in seen["note"]


def test_another_rung_is_shown_beside_the_one_that_plays(report):
    seen = report["split"]
    still, first = seen["still"], seen["first"]
    assert (still["quality"], still["time"], still["paused"]) == ("Q1+L1", 30, True)
    assert still["camera"] == first["camera"] and still["camera"]["position"] != FIRST.tolist()
    assert not seen["plays"]["paused"] and abs(seen["plays"]["apart"]) < 0.2
    assert seen["dragged"] == {"clip": "inset(0px 0px 0px 25%)", "camera": first["camera"]}
    assert seen["keyed"]["clip"] == "inset(0px 0px 0px 30%)" and seen["keyed"]["now"] == "30"
    assert "35.2 dB" in seen["keyed"]["labels"] and seen["closed"]
    assert "split=Q9+L9: expected one of Q2+L0" in seen["note"] and seen["made"] == 3


def test_what_cannot_be_loaded_later_is_said_and_the_scene_plays():
    lost = {"/web/out/pages/airgs-more.js": Answer(status=404)}
    seen = look("ui", {}, lost, ("Failed to load resource",), cases="parts")[0]["parts"]
    assert "cannot be fetched now" in seen["note"] and seen["time"] > 0 and not seen["menu"]


def test_the_region_holds_a_viewer_softly_unless_he_may_leave(report):
    seen = report["wall"]
    outside = {name: away(seen[name], FIRST) - REACH for name in ("pulled", "back", "free")}
    assert 0 < outside["pulled"] < GIVES and outside["back"] < 1e-6 and outside["free"] > 2
    assert "no quality is promised" in seen["note"] and seen["attribute"] == "free"


def test_fingers_turn_pinch_and_show_the_controls(report):
    seen = report["touch"]
    assert azimuth(seen["turned"]) < -5
    assert away(seen["pinched"]) < 0.95 * away(seen["turned"])
    assert seen["scrolled"]["by"] > 50  # one finger up and down is for the page
    assert seen["scrolled"]["camera"] == seen["pinched"]
    assert sorted(seen["there"]) == [False, True]


def test_keys_look_around_play_and_seek(report):
    seen = report["keys"]
    assert seen["focused"] == "scene"
    assert azimuth(seen["ArrowRight"]) > 5
    assert seen["ArrowUp"]["position"][1] < seen["ArrowRight"]["position"][1]  # y is down
    assert away(seen["+"]) < 0.95 * away(seen["ArrowUp"])
    assert seen["d"]["position"] != seen["+"]["position"]
    assert seen["r"]["position"] == pytest.approx(FIRST.tolist(), abs=1e-6)
    assert seen["plays"]
    sought = [float(call.split()[1]) for call in seen["calls"] if call.startswith("seek")]
    steps = np.diff([sought[0], *sought[1:]]).tolist()
    assert steps == pytest.approx([5, -5, 1 / 24, -1 / 24, 5], abs=0.011)  # the calls have two decimals
    assert seen["panel"]
    assert seen["after"] == len(seen["calls"])  # numbers do nothing
    assert "turn over" in seen["card"] and "full screen" in seen["card"] and seen["left"]


TABLE = {
    "wheel": {  # zooms only where it does not scroll the page
        "passing": [pytest.approx(AWAY), 20],
        "captured": [pytest.approx(AWAY * np.exp(-0.18), rel=0.01), 0],
        "clicked": [pytest.approx(AWAY, rel=0.01), 0],
    },
    "sound": {  # of a package that has some: muted by a button, a key and an attribute
        "offered": [False, True], "volume": 0.5,
        "seen": [[True, True], [False, False], [True, True], [False, False]],
    },
    "scrub": {  # the time line is dragged and has keys
        "dragged": pytest.approx(42, abs=0.3), "stepped": pytest.approx(47, abs=0.3), "end": 84, "home": 0,
        "aria": {"ariaValueNow": "42.0", "ariaValueMax": "84.0", "ariaValueText": "42 seconds of 1 minute 24 seconds"},
    },
    "menu": {  # chooses a rung and a speed
        "items": [["menuitemradio", text] for text in (
            "Autonow Smallest", "Best5.2 Mbit/s · 43.1 dBQ0+L3", "Good2.1 Mbit/s · 38.9 dBQ1+L2",
            "Small980 kbit/s · 35.2 dBQ1+L1", "Smallest420 kbit/s · 31.4 dBQ2+L0",
        )] + [["menuitem", "How “Auto” chooses"]],
        "picked": "Q0+L3", "closed": True, "focused": "Quality: Best · 5.2 Mbit/s · 43.1 dB", "second": "Q1+L2",
        "attribute": "Q1+L2", "speed": 2,
    },
    "live": {  # the newest is gone to
        "behind": "Live: go to the newest", "newest": "Live: this is the newest",
        "duration": 84, "time": pytest.approx(84, abs=1),
    },
    "hide": {"there": True, "gone": True, "back": True, "paused": True},  # controls, while it plays
    "life": {  # an element that is taken away leaves nothing and comes back anew
        "gone": {"closed": True, "listeners": 0, "loops": 0, "told": 0, "empty": 0},
        "again": {"other": True, "open": True, "told": True},
    },
}  # fmt: skip


@pytest.mark.parametrize("case", TABLE)
def test_what_comes_of_it(report, case):
    seen = report[case]
    assert {name: seen[name] for name in TABLE[case]} == TABLE[case]
    assert case != "life" or (seen["told"] > 0 and seen["during"] > 0 and seen["replaced"].endswith("/other.airgs/"))


def test_everything_has_a_name_and_its_place_in_the_order(report):
    seen = report["names"]
    assert all(label for _, label in seen["named"]), seen["named"]
    assert len({label for _, label in seen["named"]}) == len(seen["named"])
    order = seen["order"]
    start = ["3D view", "Play", "Seek", "Play", "Live: go to the newest"]
    assert [label for label in order if label][:5] == start
    assert "Full screen" in order and seen["live"] == "polite"
    assert seen["ups"][0] < 0 < seen["ups"][1]  # a button turns over, another one compares
    assert seen["second"] == "Q2+L0" and seen["split"] is None


def test_trouble_is_said_in_words(report):
    seen = report["trouble"]
    said = {
        "refused": ("group/3.json.gz is not what the package says", "Try again", "Copy details"),
        "newer": ("Made for another player", "Copy details"), "network": ("cannot be reached", "Try again"),
    }  # fmt: skip
    for name, words in said.items():
        assert seen[name]["role"] == "alert" and not seen[name]["controls"]
        assert all(part in seen[name]["text"] for part in words), seen[name]
    assert "Try again" not in seen["newer"]["text"]
    assert "trying again" in seen["note"] and seen["cleared"] == ""
    assert "gone for good" in seen["fatal"]


def test_the_address_says_where_to_begin_and_is_copied(report):
    seen = report["address"]
    told = "t=42.5&view=0.3,-0.5,-3.9,0.1,0,0,0,1,0&rung=Q1+L2&speed=0.5"
    opened = seen["opened"]
    assert opened["position"] == pytest.approx([0.3, -0.5, -3.9])
    assert opened["up"][1] > 0.9  # turned over
    assert (opened["rung"], opened["speed"], opened["at"]) == ("Q1+L2", 0.5, told)
    assert seen["calls"] == ["seek 42.50"]
    assert seen["note"] == "Not taken from the address: speed=-1: expected a number above 0"
    assert seen["copied"].split("#")[1] == told and "Copied" in seen["said"]
    assert seen["silent"]  # it writes no address by itself
    assert seen["moved"]["up"][1] < -0.9
    assert seen["again"]["position"] == pytest.approx(seen["moved"]["position"], abs=1e-6)
    assert seen["out"]["position"] == pytest.approx([9, 0, 0], abs=1e-6)  # as it was told, and not pulled back
    assert seen["home"]["position"] == pytest.approx(FIRST.tolist(), abs=1e-6)
    assert seen["shown"].startswith("#t=42.5&view=0,-0.6,-4,0,0,0&rung=Q1+L2")
    assert seen["plain"]["camera"]["position"] == FIRST.tolist() and seen["plain"]["offered"]


def test_a_page_without_a_package_asks_for_one():
    """player.html asks nothing of other servers, whatever folder it is in."""
    page = (WEB / "src" / "player.html").read_bytes()
    script = b"export {}; window.report = Promise.resolve([document.title, !!document.querySelector('airgs-player')]);"
    made = {"/a/b/player.html": page, "/a/b/airgs-player.js": script}
    with serve({}, made) as site:
        visits = visit_all([(f"{site.url}/a/b/player.html{query}", "") for query in ("", "?src=../fox.airgs/")])
    assert {path for path, _ in site.answers} == set(made)
    for seen in visits:  # the second one is asked for before the page's own script ran
        assert seen.failed == [] and seen.report == ["airgs player", False]
