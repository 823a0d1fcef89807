"""Pictures that the browser draws against those of the CPU renderer, from the same decoded luma."""

import base64
import json
from dataclasses import replace
from urllib.parse import urlencode

import numpy as np
import pytest

from tests.faces import SH_REST, Gaussians, LevelSettings, decode, encode, open_package, open_sequence, orbit_views
from tests.support.browser import WEB, build_pages, missing, serve, visit
from tests.support.decoded import Rung, write_decoded
from tests.support.paths import GOLDEN
from tests.support.regions import QUICK
from tests.support.rooms import room_frames
from tests.support.scenes import frozen, random_gaussians, write_sequence

PAGE = b'<!doctype html><link rel="icon" href="data:,"><script type="module" src="/web/out/pages/render.js"></script>'
LEAST_DB = {"rgba16f": 55.0, "rgb10_a2": 50.0}  # PSNR of pictures of 8 bits
SIZE = 96  # pixels either side
SHOTS = WEB / "out" / "shots"

pytestmark = pytest.mark.skipif(bool(missing()), reason=f"not here: {', '.join(missing())}")


@pytest.fixture(scope="module", autouse=True)
def _pages():
    build_pages()


def four_cameras(gaussians):
    """Three around a scene and one from close by, where Gaussians are large and cut by the picture's edge."""
    cameras = orbit_views(gaussians, 8, SIZE)[:3]
    nearer = cameras[0].world_to_camera.copy()
    nearer[2, 3] *= 0.45
    return [*cameras, replace(cameras[0], name="close", world_to_camera=nearer)]


def look(folder, check, **query):
    """What the page reports of a check; nothing may go wrong on the way, least of all in WebGL."""
    with serve({"web": WEB, "data": folder}, {"/page.html": lambda: PAGE}) as site:
        seen = visit(f"{site.url}/page.html?{urlencode({'data': '/data/scene', 'check': check} | query)}")
    assert seen.complaints() == []
    assert seen.report["errors"] == []
    return seen.report


def assert_near(report, rungs, frames, name):
    """All pictures are there, and near; one is kept to be looked at."""
    SHOTS.mkdir(parents=True, exist_ok=True)
    (SHOTS / f"{name}.png").write_bytes(base64.b64decode(report["shot"].partition(",")[2]))
    places = {(p["rung"], p["frame"], p["camera"]) for p in report["pictures"]}
    assert places == {(r, t, c) for r in range(rungs) for t in frames for c in range(4)}
    bytes_db, floats_db = (np.array([p[kind] for p in report["pictures"]]) for kind in ("bytes", "floats"))
    print(f"{name} {report['target']}: {bytes_db.min():.1f} dB at 8 bits, {floats_db.min():.1f} dB in floats")
    assert min(bytes_db.min(), floats_db.min()) >= LEAST_DB[report["target"]]


def check_package(folder, package, rungs, cameras, frames, name, *, pages=1, **query):
    """All of a package is drawn as the CPU renderer draws it."""
    write_decoded(package, folder / "scene", rungs, cameras, pages=pages)
    assert_near(look(folder, "pictures", **query), len(rungs), frames, name)


def swaying(count, degree, reach, frames=4):
    """Rows that sway by up to `reach`, turn, grow, fade and change colour; each third one stands still."""
    g = random_gaussians(count, degree, seed=degree)
    moves = (np.arange(count) % 3 > 0)[:, None].astype(np.float32)
    out = []
    for t in range(frames):
        swing = np.float32(np.sin(0.9 * t)) * moves
        turned = g.quaternions + 0.4 * swing * np.roll(g.quaternions, 1, axis=1)
        colours = (g.sh_dc + 0.3 * swing, g.sh_rest + 0.1 * swing[:, :, None])
        shape = (g.means + reach * swing, turned, g.log_scales + 0.3 * swing, g.opacity_logits + swing[:, 0])
        out.append(frozen(Gaussians(*(np.ascontiguousarray(a, np.float32) for a in (*shape, *colours)))))
    return out


def encoded(folder, frames, settings, **sequence):
    encode(open_sequence(write_sequence(folder / "scene", frames, fps=4, **sequence)), folder / "a.airgs", settings)
    return open_package(folder / "a.airgs")


def ends(package):
    return [Rung(0, 0), Rung(len(package.manifest.qualities) - 1, len(package.manifest.levels) - 1)]


@pytest.mark.parametrize("target", LEAST_DB)
@pytest.mark.parametrize("tiers", [None, 1], ids=["whole", "one tier"])
def test_the_fox_looks_as_the_cpu_renderer_draws_it(tmp_path, target, tiers):
    package = open_package(GOLDEN / "fox")
    rungs = [replace(rung, tiers=tiers) for rung in ends(package)]
    cameras = four_cameras(decode(package, 0))
    check_package(tmp_path, package, rungs, cameras, range(4), f"fox-{target}-{tiers}", target=target)


def two_groups(folder, degree):
    frames = swaying(900, degree, 0.2)
    settings = replace(QUICK, levels=(LevelSettings(0.0), LevelSettings(0.5, 2.0, quality=1)))
    return encoded(folder, frames, settings, keyframes=[0, 2]), four_cameras(frames[0])


@pytest.mark.parametrize("degree", range(len(SH_REST)))
def test_every_degree_of_spherical_harmonics(tmp_path, degree):
    package, cameras = two_groups(tmp_path, degree)
    write_decoded(package, tmp_path / "scene", ends(package), cameras)
    for target in LEAST_DB:
        report = look(tmp_path, "pictures", target=target)
        assert report["target"] == target
        assert_near(report, 2, range(4), f"degree{degree}-{target}")


@pytest.fixture(scope="module")
def levels(tmp_path_factory):
    """The same scene in both levels over one key quality."""
    folder = tmp_path_factory.mktemp("levels")
    package, cameras = two_groups(folder, 1)
    write_decoded(package, folder / "scene", [Rung(0, 0), Rung(0, 1)], cameras)
    return folder


def test_levels_change_over_a_scene(levels):
    pictures = look(levels, "levels")["pictures"]
    assert len(pictures) == 6 * 2
    assert min(p["bytes"] for p in pictures) >= LEAST_DB["rgba16f"]


def test_the_old_group_is_drawn_until_the_new_one_has_an_order(levels):
    report = look(levels, "change")
    assert (report["early"], report["same"], report["freed"]) == (False, True, False)
    assert min(report["between"]["bytes"], report["after"]["bytes"]) >= LEAST_DB["rgba16f"]


def test_after_a_lost_context_nothing_happens_and_a_new_renderer_draws(levels):
    report = look(levels, "lost")
    assert report["idle"] == [True, False, False, False]
    assert report["sizes"] == [0, 0]
    assert report["picture"]["bytes"] >= LEAST_DB["rgba16f"]


def test_a_canvas_of_any_size_and_a_background(levels):
    report = look(levels, "sizes")
    assert report["same"] and report["odd"] and not report["disposed"]
    assert report["corner"] == [64, 128, 255, 255]  # nothing of the scene is there
    assert report["length"] == 4 * 37 * 91


def test_what_cannot_be_drawn_is_said(levels):
    said = look(levels, "refusals")["messages"]
    atlas = json.loads((levels / "scene.json").read_text())["groups"][0]["levels"][0]
    samples = atlas["width"] * atlas["height"]
    assert [line.removeprefix("RenderError: ") for line in said] == [
        "a state: expected a level first, got another",
        f"luma: expected {samples} samples, got {samples - 1}",
        "a state: expected level 0, got another",
        "an order: expected at most 900 rows, got 901",
        "a browser: expected WebGL2, got none",
    ]


@pytest.mark.parametrize("every", [1, 3], ids=["every frame", "one in three"])
@pytest.mark.parametrize("lined", [False, True], ids=["bases that jump", "a line in time"])
def test_segments_are_drawn_from_atlases_of_one_page_and_of_several(tmp_path, lined, every):
    if lined:
        first, rng = random_gaussians(700), np.random.default_rng(0)
        way = rng.normal(size=(700, 3)) * np.where(np.arange(700) % 5, 0.02, 1.0)[:, None]
        frames = [frozen(replace(first, means=(first.means + t * way).astype(np.float32))) for t in range(8)]
        settings = replace(QUICK, segment_s=1.0, levels=(LevelSettings(0.0),))
    else:  # rows that move so far for their steps that bases jump
        frames, settings = swaying(700, 1, 3.0, frames=8), replace(QUICK, quality=0.05, levels=(LevelSettings(0.0),))
    package, heights = encoded(tmp_path, frames, settings), []
    for pages in (1, 3):
        shown, name = range(every - 1, 8, every), f"lined{lined}-{every}-{pages}"
        check_package(tmp_path, package, [Rung(0, 0)], four_cameras(frames[0]), shown, name, pages=pages, every=every)
        table = json.loads((tmp_path / "scene.json").read_text())
        heights.append(table["groups"][0]["levels"][0]["height"])
    segments = [s for group in table["rungs"][0]["groups"] for s in group["segments"]]
    jumping = {t for frames in segments for t, frame in enumerate(frames) if frame["changes"]}
    assert heights[1] < heights[0] / 2
    assert all(s.levels[0].line for s in package.manifest.segments) if lined else jumping >= {1, 2}


def blushing(gaussians, times):
    """The mover of a room, redder, so that the colours of groups have other axes."""
    red = gaussians.sh_dc.copy()
    red[600:] += np.float32(times) * np.array([0.8, -0.3, 0.1], np.float32) * red[600:, 1:2]
    return replace(gaussians, sh_dc=red)


def test_keys_that_are_differences_are_added_to_those_of_the_base(tmp_path):
    frames = [blushing(frame, t // 2) for t, frame in enumerate(room_frames(600, 6, 1))]
    package = encoded(tmp_path, frames, QUICK, keyframes=[0, 2, 4])
    groups = package.manifest.groups
    assert [g.keeps for g in groups] == [None, 1, 1]
    assert any(atlas.rows for tier in groups[1].tiers for atlas in tier.qualities)
    check_package(tmp_path, package, ends(package), four_cameras(frames[0]), range(6), "kept")


def test_a_segment_without_pictures_shows_the_canonical_space(tmp_path):
    package = open_package(GOLDEN / "fox-fine")
    assert package.manifest.state_files(1, 0) == []
    check_package(tmp_path, package, [Rung(0, 0)], four_cameras(decode(package, 0)), range(3), "static")
