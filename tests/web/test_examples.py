"""Examples for three.js and PlayCanvas, built by Vite from what npm packs, draw a package as we draw it, and go on."""

import shutil
from dataclasses import replace
from urllib.parse import urlencode

import numpy as np
import pytest

from tests import faces
from tests.faces import decode, levelled, look_at, open_package, render
from tests.support.browser import WEB, build_pages, missing
from tests.support.page import decibels, look, pixels_of
from tests.support.paths import GOLDEN

SIZE = 192
LEAST_DB = {"three": 23, "spark": 40, "playcanvas": 40}  # three.js cuts Gaussians at 2 deviations, dims small ones
NO_WEBGPU = ("No available adapters", "WebGPU is not available")  # what three.js then says

pytestmark = [
    pytest.mark.skipif(bool(missing()), reason=f"not here: {', '.join(missing())}"),
    pytest.mark.parametrize("example", LEAST_DB),
]


@pytest.fixture(scope="module")
def packages(package_of, tmp_path_factory):
    """The fox, a scene with all bands, and that one in a world: turned, scaled and shifted."""
    harmonics = open_package(package_of("harmonics"))
    folder = shutil.copytree(harmonics.files.path, tmp_path_factory.mktemp("placed") / "scene.airgs")
    transform = faces.world_from((0.3, -1.0, 0.5), 2.5).transform
    transform[3::4] = [4.0, -2.0, 7.0]
    root = replace(faces.root_of(harmonics.manifest), world=faces.World(transform, True))
    (folder / faces.JSON_NAME).write_bytes(faces.pack_json(root))
    return {"fox": open_package(GOLDEN / "fox"), "harmonics": harmonics, "placed": open_package(folder)}


def show(package, example, wanted, **query):
    """What an example shows of a package: its words, and its last picture (SIZE, SIZE, 3)."""
    build_pages("examples")
    page = f"/examples/{example}/index.html?{urlencode({'src': '/package/', **query}, doseq=True)}"
    folders = {"examples": WEB / "out/examples", "package": package.files.path}
    report, _ = look("examples", folders, known=NO_WEBGPU, page=page, size=SIZE, wanted=wanted)
    return report["words"], pixels_of(report["picture"], SIZE, SIZE)


@pytest.mark.parametrize("name", ["fox", "harmonics", "placed"])
def test_an_example_draws_the_first_view_of_one_frame_after_another_as_we_do(packages, name, example):
    package = packages[name]
    last = package.manifest.frames - 1
    _, picture = show(package, example, f"frame {last + 1} of {last + 1}", frame=[0, last])
    region = levelled(package.manifest.region, package.manifest.world)
    place = region.places[0]
    at = (np.array(v) for v in (place.position, place.focus, place.up))
    camera = look_at(*at, size=SIZE, fov_y=np.radians(region.fov_y), name="first")
    before, now = (decibels(picture, render(decode(package, frame), camera).rgb) for frame in (0, last))
    assert now >= max(LEAST_DB[example], before)


def test_an_example_plays_on(packages, example):
    words, picture = show(packages["harmonics"], example, 3)
    assert len(words) == 3 and all(word.startswith("frame ") for word in words)
    assert picture.std() > 10


def test_an_example_says_what_is_wrong(packages, example):
    words, _ = show(packages["harmonics"], example, 1, rung="Q9+L9")
    assert len(words) == 1 and "Q9+L9" in words[0]
