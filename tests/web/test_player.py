"""The player on a page: what it shows of packages, on slow screens and in a headset, and when something goes wrong."""

import json
import shutil

import numpy as np
import pytest

from tests.faces import Camera, before_background, decode, levelled, open_package, render, upright
from tests.support.browser import WEB, build_pages, missing, serve, visit
from tests.support.page import LEAST_DB, SHIPPED, check_sought, decibels, look, pixels_of, shipped_page
from tests.support.paths import GOLDEN, VALID
from tests.support.repeated import write_repeated

FOX = open_package(GOLDEN / "fox")
LOST = ("WebGL: CONTEXT_LOST",)  # what tests do
FPS = 8  # two frames a segment, on a slow screen
CAUSES = {"display": "this screen drops frames", "decoder": "decoding is too slow"}
BUSY_MS = 180  # a picture: of two frames, one has time; where pages are busier still, their decoder waits for them too
SIDE = 160  # pixels of an eye's picture
OUT, UP = 0.2, 0.1  # how far the lenses are ground to one side
MOVED, TURN = np.array([0.1, 0.05, -0.2]), 0.3  # of the head: metres, radians to the left
OF_IWER = ("No defined conversion between clear value",)  # it clears whatever framebuffer is bound
METRIC = {"transform": [0, -0.5, 0, 1, 0.5, 0, 0, 0, 0, 0, 0.5, 2], "metric": True}  # x is up, a unit half a metre

pytestmark = pytest.mark.skipif(bool(missing()), reason=f"not here: {', '.join(missing())}")


def with_root(folder, change):
    """The fox in a folder, with a root in which something is changed."""
    shutil.copytree(GOLDEN / "fox", folder)
    root = json.loads((folder / "airgs.json").read_text())
    change(root)
    (folder / "airgs.json").write_text(json.dumps(root))
    return open_package(folder)


def try_player(package, check, **query):
    report, _ = look("player", {"package": package.files.path}, known=LOST, src="/package/", check=check, **query)
    assert (report["problems"], report["error"]) == ([], 0)  # 0: of WebGL
    return report


def test_a_package_without_measured_quality_plays_its_best_rung():
    report = try_player(open_package(VALID / "paged"), "once")
    assert report["events"][-1] == "ended" and set(report["rungs"]) == {"Q0+L0"}


@pytest.mark.parametrize(
    ("background", "rung", "frames"),
    [(None, (1, 1), [3, 0, 2, 1]), ((1, 1, 1), (0, 0), [3, 0, 2, 1]), ((1, 0.5, 0), (0, 0), [1])],
)
def test_a_frame_that_is_sought_is_what_the_cpu_renderer_draws(tmp_path, background, rung, frames):
    """Of a group that keeps rows of another one; before the background of a package."""
    package = open_package(GOLDEN / "room")
    if background:
        package = with_root(tmp_path / "package", lambda root: root["region"].update(background=background))
    else:
        assert [group.base for group in package.manifest.groups] == [None, 1]
    m = package.manifest
    name = f"{m.qualities[rung[0]].id}+{m.levels[rung[1]].id}"
    report = try_player(package, "seek", frames=json.dumps(frames), rung=name, fps=float(m.fps))
    check_sought(package, report, rung, frames)


def test_after_the_loss_of_the_webgl_context_it_goes_on_and_while_the_page_is_hidden_nothing_is_shown():
    assert try_player(FOX, "lost")["brightness"] > 10
    report = try_player(FOX, "hidden")
    assert report["before"] == report["after"]


def test_frames_that_are_dropped_lower_the_level_unless_the_viewer_has_chosen_one(tmp_path):
    """A screen that is too slow is given less to draw, and the panel says why."""
    package = write_repeated(FOX, tmp_path / "fox.airgs", 30, FPS)
    report, _ = look("slow", {"package": package}, src="/package/", busy=BUSY_MS)
    first, held, chosen = (report[name] for name in ("first", "held", "chosen"))
    stats = held["stats"]  # by the screen, or by a decoder that other tests have slowed down
    assert (first, stats["held"]["rung"]) == ("Q0+L0", 1) and held["rung"].endswith("+L1")  # of keys that are there
    assert f"at {held['rung']}: {CAUSES[stats['held']['by']]}" in held["panel"]
    assert stats["framesDropped"] > 0.15 * (stats["framesShown"] + stats["framesDropped"])
    assert (chosen["rung"], chosen["stats"]["held"]) == (first, None) and "Held" not in chosen["panel"]


# In a headset that only pretends, and without


def put_on(folder, query=""):
    build_pages()
    made = {"/page/player.html": shipped_page("vr")}
    with serve({"web": WEB, "page": SHIPPED, "scene": folder}, made) as site:
        seen = visit(f"{site.url}/page/player.html?src=/scene/{query}")
    assert seen.complaints(OF_IWER) == []
    return seen.report, [path for path, _ in site.answers]


@pytest.fixture(scope="module", params=[None, METRIC], ids=["no units", "metres"])
def worn(request, tmp_path_factory):
    """A package, and what came of a visit with a headset."""

    def change(root):
        if request.param:
            root["world"] = request.param
        else:  # a first view that looks far down
            root["region"]["places"].sort(key=lambda place: -abs(place["position"][1] - place["focus"][1]))

    package = with_root(tmp_path_factory.mktemp("vr") / "package", change)
    report, asked = put_on(package.files.path)
    assert "/page/airgs-vr.js" in asked
    return package, report


def _across(a, axis):
    """The part of a direction at a right angle to another one, of length 1."""
    part = a - (a @ axis) / (axis @ axis) * axis
    return part / np.linalg.norm(part)


def eye_of(package, offset, head, turn):
    """The camera of an eye `offset` metres to the right of the middle of a head at `head`, turned to the left."""
    m = package.manifest
    region = levelled(m.region, m.world)
    place, up = region.places[0], np.array(upright(region))
    ahead = np.subtract(place.focus, place.position)
    unit = 2.0 if m.world else np.linalg.norm(ahead) / 1.5  # of a metre
    up = up if m.world else _across(up, ahead)  # without a world it is straight ahead
    back = -_across(ahead, up)
    room = np.array([np.cross(up, back), up, back]).T  # to the scene
    turned = np.array([[np.cos(turn), 0, np.sin(turn)], [0, 1, 0], [-np.sin(turn), 0, np.cos(turn)]])
    axes = (room @ turned * [1, -1, -1]).T  # x right, y down, z ahead
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = axes, -axes @ (place.position + unit * room @ (head + turned @ [offset, 0, 0]))
    half = SIDE / 2
    centre = half * (1 - np.copysign(OUT, offset)), half * (1 + UP)
    return before_background(m.region, [Camera("eye", SIDE, SIDE, half, half, *centre, matrix, near=region.near)])[0]


@pytest.mark.parametrize(("which", "head", "turn"), [("first", np.zeros(3), 0.0), ("moved", MOVED, TURN)])
def test_each_eye_sees_what_the_cpu_renderer_draws_from_there(worn, which, head, turn):
    package, report = worn
    pixels = pixels_of(report[which], 2 * SIDE, SIDE)
    halves = pixels[:, :SIDE], pixels[:, SIDE:]
    assert all(half.std() > 5 for half in halves) and (halves[0] != halves[1]).any()
    shown = decode(package, 0)
    for half, offset in zip(halves, (-report["ipd"] / 2, report["ipd"] / 2), strict=True):
        assert decibels(half, render(shown, eye_of(package, offset, head, turn)).rgb) >= LEAST_DB


def test_a_frame_is_sorted_once_and_drawn_twice_and_who_leaves_finds_the_page_as_it_was(worn):
    _, report = worn
    counted = report["counted"]
    assert counted["draws"] == 2 * counted["frames"]
    assert 1 <= counted["sorts"] <= counted["frames"] + 1  # that of the frame before may have waited
    assert report["played"] and report["goesOn"] and report["page"]  # a trigger plays
    assert report["after"] == pytest.approx(report["before"])


def test_without_a_headset_there_is_no_button_and_nothing_is_fetched_for_one():
    report, asked = put_on(GOLDEN / "fox", "&without")
    assert report == {"there": True, "shown": False}
    assert not [path for path in asked if "vr" in path and path.startswith("/page")]
