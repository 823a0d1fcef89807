"""Scenes in tiles: viewers, what was on the screen, and what tiles save."""

import math
import shutil

import numpy as np
import pytest

from airgs_codec.play.session import simulate
from airgs_codec.play.settings import SessionSettings
from airgs_codec.play.trace import Trace
from airgs_codec.scene.formats.ply import write_ply
from airgs_codec.scene.sequence import open_sequence
from tests.support.paths import FOX
from tests.support.regions import region
from tools.lab.command import Lab
from tools.lab.tiles.experiment import (
    NARROW,
    Options,
    links_over,
    packages,
    price_words,
    run,
    saved_words,
    scenes,
    span_words,
    wait_words,
)  # fmt: skip
from tools.lab.tiles.runs import (
    AMPLE,
    BY_VIEW,
    HELD_OUT,
    TILED,
    VIEWERS,
    WHOLE,
    Watcher,
    add_savings,
    drawn_swings,
    links_of,
)  # fmt: skip
from tools.lab.tiles.screen import Screen, Seen, touches
from tools.make_wide_scene import main as make_wide_scene
from tools.make_wide_scene import to_and_fro


@pytest.fixture(scope="module")
def fox(tmp_path_factory):
    """Three frames of a small fox with its cameras."""
    folder, whole = tmp_path_factory.mktemp("fox"), open_sequence(FOX)
    rows = np.sort(np.random.default_rng(0).permutation(5000)[:400])
    for frame in range(3):
        write_ply(folder / f"{frame:02d}.ply", whole.read(frame).take(rows))
    shutil.copy(FOX / "transforms.json", folder)
    return folder


@pytest.fixture(scope="module")
def wide(fox, tmp_path_factory):
    """Four small foxes in a ring."""
    folder = tmp_path_factory.mktemp("wide") / "ring"
    assert make_wide_scene([str(fox), "-o", str(folder), "--copies", "4", "--length", "4"]) == 0
    return open_sequence(folder)


def test_copies_go_to_and_fro_each_from_another_frame():
    assert [to_and_fro(t, 0, 2, 3) for t in range(6)] == [0, 1, 2, 1, 0, 1]
    assert [to_and_fro(t, 1, 2, 3) for t in range(3)] == [2, 1, 0]
    assert to_and_fro(5, 3, 4, 1) == 0


def test_the_scene_is_a_ring_that_is_seen_from_its_middle(wide):
    assert len(wide) == 4 and wide.headers[0].count == 1600 and wide.keyframes == (0,)
    frame = wide.read(0)
    away = [np.median(frame.means[400 * k : 400 * (k + 1), [0, 2]], axis=0) for k in range(4)]
    assert np.linalg.norm(away[1]) > 1.3 * np.linalg.norm(away[0])
    assert sum(camera.held_out for camera in wide.cameras) == 6
    for camera in wide.cameras:
        out = camera.world_to_camera[2, [0, 2]]
        assert out @ camera.position[[0, 2]] > 0
        assert np.linalg.norm(camera.position[[0, 2]]) < 0.2 * np.linalg.norm(away[0])


def test_viewers_turn_as_their_names_say():
    pace = {name: Watcher.of(region(), name).turning(6.0) for name in (*VIEWERS, HELD_OUT)}
    assert pace["lively"] > pace["calm"] > pace["even"] > 0 and pace[HELD_OUT] > pace["even"]
    assert drawn_swings(1) == drawn_swings(1) != drawn_swings(2)


def test_what_touches_a_picture(wide):
    frame, camera = wide.read(0), wide.cameras[0]
    ahead = (frame.means - camera.position) @ camera.world_to_camera[2, :3]
    assert touches(frame, camera)
    assert not touches(frame.take(np.flatnonzero(ahead < 0)), camera)


def test_savings_are_at_equal_quality():
    rows = [
        {"how": WHOLE, "psnr": 40.0, "bytes": 4000, "stalls": 0},
        {"how": WHOLE, "psnr": 30.0, "bytes": 1000, "stalls": 0},
        {"how": BY_VIEW, "psnr": 35.0, "bytes": 1000, "stalls": 0},
        {"how": BY_VIEW, "psnr": 29.0, "bytes": 100, "stalls": 0},
    ]
    add_savings(rows)
    assert [row["saved"] for row in rows] == [pytest.approx(0), pytest.approx(0), pytest.approx(0.5), None]


def test_links_are_scaled_to_the_rate():
    links = links_of(2e6, [1.5, 3.0], "markov:1", 20.0)
    carried = [8 * link.bytes_between(0.0, 20.0) / 20.0 for link in links.values()]
    assert carried == pytest.approx([3e6, 6e6, 3e6, 6e6], rel=1e-6)


def test_errors_are_pooled():
    seen = Seen()
    assert math.isnan(seen.psnr)
    seen.add(np.full((2, 2), 1e-2, np.float32))
    seen.add(np.full((2, 2), 1e-4, np.float32))
    assert seen.worst_psnr == pytest.approx(20) and seen.psnr == pytest.approx(-10 * math.log10((1e-2 + 1e-4) / 2))


def test_the_bench_runs_and_says_what_was_seen(fox, tmp_path):
    options = Options(
        fox, frames=3, copies=4, tiles=2, few_tiles=2, seconds=0.4, segment=0.1, viewers=("lively",), rungs=(0,),
        times=(2.0,), ticks=1, trace="markov:1", view_buffer=1.0,
    )  # fmt: skip
    page = run(options, Lab.at(tmp_path, quiet=True))
    links, played = (table.rows for table in page.tables())
    assert {row["scene"] for row in played} == {NARROW, "4 in a ring"}
    assert len(links) == 4 and {row["link"] for row in links[:2]} == {row["link"] for row in links[2:]}
    wide = [row for row in played if row["scene"] != NARROW]
    assert {row["how"] for row in wide} == {WHOLE, TILED, BY_VIEW} and len({row["link"] for row in wide}) == 3
    best = {row["how"]: row["psnr"] for row in wide if row["rung"] == 0 and row["link"] == "ample"}
    assert best[WHOLE] > 30 and abs(best[WHOLE] - best[TILED]) < 2 and best[BY_VIEW] <= best[TILED] + 1e-6
    assert all(row["missing_s"] >= 0 and 0 < row["fetched"] <= 1 for row in wide if row["how"] == BY_VIEW)
    assert (
        "2 tiles of the ring, 2 of the scene as it is, 0.4 s of play, links of 2 times the rate" in page.how
        and "lively" in page.how
    )
    made = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*") if path.suffix in (".json", ".ply")}
    assert len(scenes(options, tmp_path)["4 in a ring"]) == 6
    assert made == {path: path.stat().st_mtime_ns for path in made}


def test_links_are_told_of_by_what_viewers_save_lack_and_wait():
    known = {"scene": "a", "link": "2 x", "missing_s": 0.0, "stall_s": 0.0}
    rows = [
        known | {"how": BY_VIEW, "saved": 0.3, "missing_s": 0.1},
        known | {"how": BY_VIEW, "saved": 0.35, "stall_s": 0.2},
        known | {"how": TILED, "saved": -0.05, "stall_s": 0.01},
        known | {"how": TILED, "saved": None, "link": AMPLE},
    ]
    (row,) = links_over(rows)
    assert row == {
        "scene": "a", "link": "2 x", "least": 0.3, "most": 0.35, "lacking_s": 0.1, "stall_s": 0.2, "tiled_s": 0.01
    }  # fmt: skip
    assert saved_words([row]).endswith("fetching the tiles in sight saves 30 to 35 % of the bytes (a).")
    assert wait_words([row], 12.0) == (
        "Of 12 s something in sight is lacking for 0.10 s at most, and the picture stands still for 0.20 s, 0.01 s "
        "where all tiles are fetched."
    )
    assert price_words(rows) == "All tiles take more bytes than one package: 5 % (a)."


@pytest.mark.parametrize(
    ("shares", "words"),
    [
        ([0.30, 0.37], "saves 30 to 37 % of the bytes"),
        ([-0.10, -0.05], "takes 5 to 10 % more"),
        ([-0.05, 0.02], "saves nothing for sure, -5 to 2 % of the bytes"),
        ([], "is not comparable"),
    ],
)
def test_savings_may_be_losses(shares, words):
    assert span_words(shares) == words


def test_what_was_lacking_is_drawn_as_lacking(wide, tmp_path):
    """The same session with nothing fetched but one tile is no better than with all."""
    _, tiled = packages(wide, "wide", Options(wide.folder, tiles=4, segment=0.1), Lab.at(tmp_path, quiet=True))
    view = Watcher.of(tiled.manifest.region, "even")
    log = simulate(tiled, Trace.open("const:100"), "fixed:0", SessionSettings(loops=1))
    screen = Screen(wide, tiled, view, 1, {})
    (moment,) = screen.moments(log)[:1]
    alone = [screen.squares(log, type(moment)(moment.frame, moment.at_s, (pair,))).mean() for pair in moment.tiles]
    assert screen.squares(log, moment).mean() < min(alone)
