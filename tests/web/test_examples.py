"""The examples for users of three.js and PlayCanvas in a real browser: they draw a package as we draw it, and go on."""

import base64
import shutil
import subprocess
from dataclasses import replace
from urllib.parse import urlencode

import numpy as np
import pytest

from tests.faces import (
    JSON_NAME,
    World,
    decode,
    encode,
    levelled,
    look_at,
    open_package,
    open_sequence,
    pack_json,
    psnr,
    render,
    root_of,
    world_from,
)
from tests.support.browser import WEB, missing, serve, visit
from tests.support.paths import GOLDEN
from tests.support.regions import QUICK
from tests.support.scenes import moving_frames, write_sequence

SIZE = 192
LEAST_DB = 40  # what docs/results/views.md says is more
SHOWN = 3
PAGE = b'<!doctype html><link rel="icon" href="data:," /><script type="module" src="/pages/examples.js"></script>'

pytestmark = pytest.mark.skipif(bool(missing()), reason=f"not here: {', '.join(missing())}")


@pytest.fixture(scope="module")
def built():
    for script in ("examples.mjs", "pages.mjs"):
        subprocess.run(["node", WEB / "scripts" / script], check=True)


@pytest.fixture(scope="module")
def harmonics(tmp_path_factory):
    folder = tmp_path_factory.mktemp("harmonics")
    scene = write_sequence(folder / "scene", moving_frames(300, 4, degree=3), fps=4, keyframes=[0, 2])
    encode(open_sequence(scene), folder / "scene.airgs", QUICK)
    return open_package(folder / "scene.airgs")


@pytest.fixture(scope="module")
def placed(harmonics, tmp_path_factory):
    """The same in a world: turned, scaled and shifted."""
    folder = tmp_path_factory.mktemp("placed") / "scene.airgs"
    shutil.copytree(harmonics.files.path, folder)
    transform = world_from((0.3, -1.0, 0.5), 2.5).transform
    transform[3::4] = [4.0, -2.0, 7.0]
    (folder / JSON_NAME).write_bytes(pack_json(replace(root_of(harmonics.manifest), world=World(transform, True))))
    return open_package(folder)


@pytest.fixture(params=["fox", "harmonics", "placed"])
def package(request):
    return open_package(GOLDEN / "fox") if request.param == "fox" else request.getfixturevalue(request.param)


def look(package, example, wanted, **query):
    """What an example shows of a package: its words, and its last picture (SIZE, SIZE, 3)."""
    page = f"/examples/{example}/index.html?{urlencode({'src': '/package/', **query})}"
    folders = {"examples": WEB / "out/examples", "pages": WEB / "out/pages", "package": package.files.path}
    with serve(folders, {"/page.html": lambda: PAGE}) as site:
        seen = visit(f"{site.url}/page.html?{urlencode({'page': page, 'size': SIZE, 'wanted': wanted})}")
    assert seen.complaints() == []
    pixels = np.frombuffer(base64.b64decode(seen.report["picture"]), np.uint8).reshape(SIZE, SIZE, 4)
    return seen.report["words"], pixels[..., :3]


@pytest.mark.parametrize("example", ["spark", "playcanvas"])
def test_an_example_draws_the_first_view_of_a_package_as_we_do(built, package, example):
    words, picture = look(package, example, 1, frame=1)
    assert words == [f"frame 2 of {package.manifest.frames}"]
    region = levelled(package.manifest.region, package.manifest.world)
    place = region.places[0]
    at = (np.array(v) for v in (place.position, place.focus, place.up))
    camera = look_at(*at, size=SIZE, fov_y=np.radians(region.fov_y), name="first")
    truth = np.round(render(decode(package, 1), camera).rgb.clip(0, 1) * 255)
    assert truth.std() > 10
    assert psnr(float(np.mean((picture - truth) ** 2)) / 255**2) >= LEAST_DB


@pytest.mark.parametrize("example", ["spark", "playcanvas"])
def test_an_example_plays_on(built, harmonics, example):
    words, picture = look(harmonics, example, SHOWN)
    assert len(words) == SHOWN and all(word.startswith("frame ") for word in words)
    assert picture.std() > 10


@pytest.mark.parametrize("example", ["spark", "playcanvas"])
def test_an_example_says_what_is_wrong(built, harmonics, example):
    words, _ = look(harmonics, example, 1, rung="Q9+L9")
    assert len(words) == 1 and "Q9+L9" in words[0]
