"""The page that is shipped, in a browser with a headset that only pretends, and without (web/test/pages/vr.ts)."""

import base64
import json
import shutil

import numpy as np
import pytest

from airgs_codec.serve.pages import PAGE
from tests.faces import (
    Camera,
    before_background,
    content_policy,
    decode,
    levelled,
    mse,
    open_package,
    psnr,
    render,
    upright,
)
from tests.support.browser import WEB, Answer, build_pages, missing, serve, visit
from tests.support.paths import GOLDEN
from tests.support.player_page import LEAST_DB

DRIVER = '<script type="module" src="/web/out/pages/vr.js"></script>'
SIDE = 160  # pixels of an eye's picture
OUT, UP = 0.2, 0.1  # how far the lenses are ground to one side
MOVED, TURN = np.array([0.1, 0.05, -0.2]), 0.3  # of the head: metres, radians to the left
KNOWN = ("No defined conversion between clear value",)  # iwer clears whatever framebuffer is bound
METRIC = {"transform": [0, -0.5, 0, 1, 0.5, 0, 0, 0, 0, 0, 0.5, 2], "metric": True}  # x is up, a unit half a metre

pytestmark = pytest.mark.skipif(bool(missing()), reason=f"not here: {', '.join(missing())}")


def look(folder, query=""):
    """What the page reports of a package, under the policy that the server sends with it."""
    build_pages()
    page = (PAGE / "player.html").read_text().replace("<head>", f"<head>{DRIVER}")
    answer = Answer(page.encode(), headers={"Content-Security-Policy": content_policy(page)})
    with serve({"web": WEB, "page": PAGE, "scene": folder}, {"/page/player.html": lambda: answer}) as site:
        seen = visit(f"{site.url}/page/player.html?src=/scene/{query}")
    assert seen.complaints(KNOWN) == []
    return seen.report, [path for path, _ in site.answers]


@pytest.fixture(scope="module", params=[None, METRIC], ids=["no units", "metres"])
def worn(request, tmp_path_factory):
    """A package, and what came of a visit with a headset."""
    folder = shutil.copytree(GOLDEN / "fox", tmp_path_factory.mktemp("vr") / "package")
    root = json.loads((folder / "airgs.json").read_text())
    if request.param:
        root["world"] = request.param
    else:  # a first view that looks far down
        root["region"]["places"].sort(key=lambda place: -abs(place["position"][1] - place["focus"][1]))
    (folder / "airgs.json").write_text(json.dumps(root))
    report, asked = look(folder)
    assert "/page/airgs-vr.js" in asked
    return open_package(folder), report


def _across(a, axis):
    """The part of a direction at a right angle to another one, of length 1."""
    part = a - (a @ axis) / (axis @ axis) * axis
    return part / np.linalg.norm(part)


def eye_of(package, offset, head, turn):
    """The camera of an eye `offset` metres to the right of the middle of a head at `head`, turned to the left."""
    m = package.manifest
    region = levelled(m.region, m.world)
    place = region.places[0]
    up = np.array(upright(region))
    ahead = np.subtract(place.focus, place.position)
    unit = 2.0 if m.world else np.linalg.norm(ahead) / 1.5  # of a metre
    if m.world is None:  # it is straight ahead
        up = _across(up, ahead)
    back = -_across(ahead, up)
    room = np.array([np.cross(up, back), up, back]).T  # to the scene
    turned = np.array([[np.cos(turn), 0, np.sin(turn)], [0, 1, 0], [-np.sin(turn), 0, np.cos(turn)]])
    position = place.position + unit * room @ (head + turned @ [offset, 0, 0])
    axes = (room @ turned * [1, -1, -1]).T  # x right, y down, z ahead
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = axes, -axes @ position
    half = SIDE / 2
    cx = half * (1 - np.copysign(OUT, offset))
    eye = Camera("eye", SIDE, SIDE, half, half, cx, half * (1 + UP), matrix, near=region.near)
    [before] = before_background(m.region, [eye])
    return before


@pytest.mark.parametrize(("which", "head", "turn"), [("first", np.zeros(3), 0.0), ("moved", MOVED, TURN)])
def test_each_eye_sees_what_the_cpu_renderer_draws_from_there(worn, which, head, turn):
    package, report = worn
    pixels = np.frombuffer(base64.b64decode(report[which]), np.uint8).reshape(SIDE, 2 * SIDE, 4)[..., :3]
    halves = pixels[:, :SIDE], pixels[:, SIDE:]
    assert all(half.std() > 5 for half in halves) and (halves[0] != halves[1]).any()
    shown = decode(package, 0)
    for half, offset in zip(halves, (-report["ipd"] / 2, report["ipd"] / 2), strict=True):
        truth = np.round(255 * render(shown, eye_of(package, offset, head, turn)).rgb.clip(0, 1)) / np.float32(255)
        assert psnr(mse((half / 255).astype(np.float32), truth)) >= LEAST_DB


def test_a_frame_is_sorted_once_and_drawn_twice(worn):
    counted = worn[1]["counted"]
    assert counted["draws"] == 2 * counted["frames"]
    assert 1 <= counted["sorts"] <= counted["frames"] + 1  # that of the frame before may have waited


def test_a_trigger_plays_and_who_leaves_finds_the_page_as_it_was(worn):
    _, report = worn
    assert report["played"] and report["goesOn"]
    assert report["page"]
    assert report["after"] == pytest.approx(report["before"])


def test_without_a_headset_there_is_no_button_and_nothing_is_fetched_for_one():
    report, asked = look(GOLDEN / "fox", "&without")
    assert report == {"there": True, "shown": False}
    assert not [path for path in asked if "vr" in path and path.startswith("/page")]
