"""Pictures that the browser draws against those of the CPU renderer, from the same decoded luma."""

import json
from dataclasses import replace

import numpy as np
import pytest

from tests.faces import Gaussians, decode, open_package, orbit_views
from tests.support.browser import missing
from tests.support.decoded import Rung, write_decoded
from tests.support.packages import TWO_LEVELS, Encoded
from tests.support.page import look
from tests.support.paths import GOLDEN, VALID
from tests.support.regions import QUICK
from tests.support.scenes import frozen, random_gaussians, room_frames

LEAST_DB = {"rgba16f": 55.0, "rgb10_a2": 50.0}  # PSNR of pictures of 8 bits
SIZE = 96  # pixels either side
STEP = {"check": "pictures", "target": "rgba16f", "every": 1}

pytestmark = pytest.mark.skipif(bool(missing()), reason=f"not here: {', '.join(missing())}")


def four_cameras(gaussians):
    """Three around a scene and one from close by, where Gaussians are large and cut by the picture's edge."""
    cameras = orbit_views(gaussians, 8, SIZE)[:3]
    nearer = cameras[0].world_to_camera.copy()
    nearer[2, 3] *= 0.45
    return [*cameras, replace(cameras[0], name="close", world_to_camera=nearer)]


def jumping_groups():
    """Rows that turn, fade and move so far that bases jump; each third one stands still. The first has two segments."""
    g, frames = random_gaussians(700, 2, seed=2), []
    moves = (np.arange(700) % 3 > 0)[:, None].astype(np.float32)
    for t in range(8):
        swing = np.float32(np.sin(0.9 * t)) * moves
        turned = g.quaternions + 0.4 * swing * np.roll(g.quaternions, 1, axis=1)
        colours = (g.sh_dc + 0.3 * swing, g.sh_rest + 0.1 * swing[:, :, None])
        shape = (g.means + 3 * swing, turned, g.log_scales + 0.3 * swing, g.opacity_logits + swing[:, 0])
        frames.append(frozen(Gaussians(*(np.ascontiguousarray(a, np.float32) for a in (*shape, *colours)))))
    return [frames[:6], frames[6:]]


def room_groups():
    frames = room_frames(600, 6, 1)
    red = np.zeros_like(frames[0].sh_dc)
    red[600:] = np.array([0.8, -0.3, 0.1], np.float32) * frames[0].sh_dc[600:, 1:2]
    frames = [replace(frame, sh_dc=frame.sh_dc + np.float32(t // 2) * red) for t, frame in enumerate(frames)]
    return [frames[:2], frames[2:4], frames[4:]]


ENCODED = {
    "jumping": Encoded(jumping_groups, replace(QUICK, quality=0.05, levels=TWO_LEVELS), fps=4, cameras=True),
    "room": Encoded(room_groups, QUICK, fps=4, cameras=True),
}
COMMITTED = {"fox": GOLDEN / "fox", "still": GOLDEN / "fox-fine", "flat": VALID / "moving"}
DRAWN = {  # name of data -> (package, keyframe tiers that are there, pages of atlases, whether both ends of the ladder)
    "fox": ("fox", None, 1, True),
    "fox, one tier": ("fox", 1, 1, True),
    "flat": ("flat", None, 1, True),
    "jumping": ("jumping", None, 1, True),
    "jumping, pages": ("jumping", None, 3, False),
    "lined": ("lined", None, 1, True),
    "lined, pages": ("lined", None, 3, False),
    "room": ("room", None, 1, True),
    "still": ("still", None, 1, False),
}
PICTURES = [
    *((name, "rgba16f", 1) for name in DRAWN),
    *((f"{name}{pages}", "rgba16f", 3) for name in ("jumping", "lined") for pages in ("", ", pages")),
    *((name, "rgb10_a2", 1) for name in ("fox", "fox, one tier", "flat", "jumping, pages", "lined, pages")),
]  # data, target, one of how many frames is shown
OTHERS = {  # check of web/test/pages/render.ts -> how many pictures it compares, and what else it says
    "levels": (6 * 2, {}),  # change over a scene
    "change": (2, {"early": False, "same": True, "freed": False}),  # the old group until the new one has an order
    "lost": (1, {"idle": [True, False, False, False], "sizes": [0, 0]}),  # a context: nothing, until a new renderer
    "sizes": (0, {  # any, and a background in a corner without anything of the scene
        "same": True, "odd": True, "disposed": False, "corner": [64, 128, 255, 255], "length": 4 * 37 * 91,
    }),
}  # fmt: skip


@pytest.fixture(scope="module")
def packages(tmp_path_factory, package_of):
    folder = tmp_path_factory.mktemp("packages")
    for name, encoded in ENCODED.items():
        encoded(folder / name)
    paths = COMMITTED | {name: folder / name for name in ENCODED} | {"lined": package_of("harmonics")}
    return {name: open_package(path) for name, path in paths.items()}


@pytest.fixture(scope="module")
def data(packages, tmp_path_factory):
    folder = tmp_path_factory.mktemp("data")
    cameras = {name: four_cameras(decode(package, 0)) for name, package in packages.items()}
    for name, (which, tiers, pages, both) in DRAWN.items():
        m = packages[which].manifest
        ends = [Rung(0, 0, tiers), Rung(len(m.qualities) - 1, len(m.levels) - 1, tiers)]
        write_decoded(packages[which], folder / name, ends[: 1 + both], cameras[which], pages=pages)
    write_decoded(packages["fox"], folder / "levels", [Rung(0, 0), Rung(0, 1)], cameras["fox"])
    return folder


@pytest.fixture(scope="module")
def seen(data):
    """What the page reports of each step, in which nothing went wrong, least of all in WebGL."""
    steps = [STEP | {"name": f"{step}", "data": step[0], "target": step[1], "every": step[2]} for step in PICTURES]
    steps += [STEP | {"name": check, "check": check, "data": "levels"} for check in (*OTHERS, "refusals")]
    plan = [step | {"data": f"/data/{step['data']}"} for step in steps]
    report, _ = look("render", {"data": data}, {"/plan.json": json.dumps(plan).encode()})
    assert all(came["errors"] == [] for came in report.values())
    return report


@pytest.mark.parametrize("step", PICTURES, ids=str)
def test_every_frame_looks_as_the_cpu_renderer_draws_it(seen, packages, step):
    name, target, every = step
    report, (which, _, _, both) = seen[f"{step}"], DRAWN[name]
    places = {(p["rung"], p["frame"], p["camera"]) for p in report["pictures"]}
    frames = range(every - 1, packages[which].manifest.frames, every)
    assert report["target"] == target
    assert places == {(rung, t, camera) for rung in range(1 + both) for t in frames for camera in range(4)}
    assert min(min(p["bytes"], p["floats"]) for p in report["pictures"]) >= LEAST_DB[target]


def tables_of(data, name):
    return json.loads((data / f"{name}.json").read_text())


def test_what_is_drawn_is_what_it_is_named_after(packages, data):
    """Degrees of spherical harmonics, atlases of several pages, bases that jump, lines, differences, no pictures."""
    manifests = {name: package.manifest for name, package in packages.items()}
    degrees = {"flat": 0, "fox": 1, "room": 1, "still": 1, "jumping": 2, "lined": 3}
    assert {name: m.sh_degree for name, m in manifests.items()} == degrees
    for name in ("jumping", "lined"):
        tables = [tables_of(data, f"{name}{pages}") for pages in ("", ", pages")]
        whole, cut = (table["groups"][0]["levels"][0]["height"] for table in tables)
        assert cut < whole / 2
    segments = [s for group in tables_of(data, "jumping")["rungs"][0]["groups"] for s in group["segments"]]
    assert {t for frames in segments for t, frame in enumerate(frames) if frame["changes"]} >= {1, 2}
    assert all(s.levels[0].slopes for s in manifests["lined"].segments)
    room = manifests["room"].groups
    assert [g.base for g in room] == [None, 1, 1]
    assert any(atlas.rows for tier in room[1].tiers for atlas in tier.qualities)
    assert manifests["still"].delta_files(1, 0) == []


@pytest.mark.parametrize("check", OTHERS)
def test_what_else_is_done_to_a_scene(seen, check):
    report, (count, expected) = seen[check], OTHERS[check]
    one = [report[name] for name in ("between", "after", "picture") if name in report]
    pictures = [p["bytes"] for p in report.get("pictures", one)]
    assert len(pictures) == count and all(decibels >= LEAST_DB["rgba16f"] for decibels in pictures)
    assert report | expected == report


def test_what_cannot_be_drawn_is_said(seen, data):
    atlas = tables_of(data, "levels")["groups"][0]["levels"][0]
    samples = atlas["width"] * atlas["height"]
    assert [line.removeprefix("RenderError: ") for line in seen["refusals"]["messages"]] == [
        "a delta: expected a level first, got another",
        f"luma: expected {samples} samples, got {samples - 1}",
        "a delta: expected level 0, got another",
        "an order: expected at most 700 rows, got 701",
        "a browser: expected WebGL2, got none",
    ]
