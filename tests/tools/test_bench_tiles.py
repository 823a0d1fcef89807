"""Scenes in tiles: what is cut, what is in sight, what is fetched for it, and what that saves."""

import math
from dataclasses import replace

import numpy as np
import pytest

from airgs_codec.package.region import with_background
from airgs_codec.package.store import open_package
from airgs_codec.play.session import simulate
from airgs_codec.play.settings import SessionSettings
from airgs_codec.play.trace import open_trace
from airgs_codec.scene.camera import look_at
from airgs_codec.scene.ply import write_ply
from airgs_codec.scene.sequence import open_sequence
from tests.support.paths import FOX, VALID
from tests.support.regions import region
from tools import bench_tiles
from tools.make_wide_scene import main as make_wide_scene
from tools.make_wide_scene import to_and_fro
from tools.tiles.measure import WHOLE, savings
from tools.tiles.rules import Rule
from tools.tiles.split import CUTS, Tile, border_rows, restricted, split
from tools.tiles.stock import Stock
from tools.tiles.viewer import Watcher, distance, in_sight, touches


@pytest.fixture(scope="module")
def wide(tmp_path_factory):
    """Four small foxes in a ring."""
    folder = tmp_path_factory.mktemp("wide")
    fox = open_sequence(FOX)
    rows = np.sort(np.random.default_rng(0).permutation(5000)[:400])
    (folder / "fox").mkdir()
    for frame in range(3):
        write_ply(folder / "fox" / f"{frame:02d}.ply", fox.read(frame).take(rows))
    assert make_wide_scene([str(folder / "fox"), "-o", str(folder / "ring"), "--copies", "4", "--length", "4"]) == 0
    return open_sequence(folder / "ring")


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


@pytest.mark.parametrize("cut", CUTS)
def test_every_row_is_in_one_tile_and_stays_there(wide, cut):
    tiles = split(wide, 3, cut)
    assert np.array_equal(np.sort(np.concatenate([tile.rows for tile in tiles])), np.arange(1600))
    assert max(len(tile.rows) for tile in tiles) - min(len(tile.rows) for tile in tiles) <= 1
    for tile in tiles:
        part = restricted(wide, tile)
        assert part.headers[0].count == len(tile.rows)
        for t in range(len(wide)):
            assert np.array_equal(part.read(t).means, wide.read(t).means[tile.rows])
        within = np.all(
            (wide.read(0).means[tile.rows] >= tile.low) & (wide.read(0).means[tile.rows] <= tile.high), axis=1
        )
        assert within.mean() > 0.9
    border = border_rows(wide.read(0), tiles)
    assert 0 < border.mean() < 0.5


def test_what_is_in_sight(wide):
    """Four tiles of the four foxes: a camera that looks at one does not have the one behind it in its picture."""
    frame, camera = wide.read(0), wide.cameras[0]
    tiles = sorted(split(wide, 4), key=lambda tile: float((tile.low + tile.high)[0]))
    behind, ahead = tiles[0], tiles[-1]
    assert in_sight(ahead, camera, 0.0) and touches(frame.take(ahead.rows), camera)
    assert not in_sight(behind, camera, 0.0) and not touches(frame.take(behind.rows), camera)
    assert not in_sight(behind, camera, 30.0)


def test_a_margin_widens_what_is_in_sight():
    """A camera of 90 degrees, and a box 60 degrees off its axis."""
    camera = look_at(np.zeros(3), np.array([0.0, 0, 1]), np.array([0.0, 1, 0]), size=64, fov_y=np.pi / 2, name="")
    middle = np.array([np.sin(np.radians(60)), 0.0, np.cos(np.radians(60))])
    box = Tile(np.arange(1, dtype=np.int32), middle - 0.01, middle + 0.01)
    assert [in_sight(box, camera, margin) for margin in (0.0, 10.0, 20.0)] == [False, False, True]
    assert distance(box, camera) == pytest.approx(1, abs=0.02)


def test_a_player_expects_a_viewer_to_go_on_turning_for_a_while():
    cameras = Watcher.of(region(), 4.0)
    now = cameras.at(1.0)
    assert np.allclose(cameras.expected(1.0, 1.0).world_to_camera, now.world_to_camera)
    assert np.allclose(cameras.expected(math.inf, 2.0).world_to_camera, cameras.at(2.0).world_to_camera)
    soon, actual = cameras.expected(1.0, 1.1), cameras.at(1.1)
    turned = np.linalg.norm(actual.world_to_camera[2, :3] - now.world_to_camera[2, :3])
    assert np.linalg.norm(actual.world_to_camera[2, :3] - soon.world_to_camera[2, :3]) < 0.5 * turned
    rotation = cameras.expected(1.0, 9.0).world_to_camera[:3, :3]
    assert np.allclose(rotation @ rotation.T, np.eye(3))


def test_rules(wide):
    tiles = sorted(split(wide, 4), key=lambda tile: float((tile.low + tile.high)[0]))
    still = Watcher([wide.cameras[0]])
    factors = [1.0, 1.4, 4.0]
    choice = Rule("", 0, margin=0.0).choose(tiles, still, (0.0, 0.5), factors)
    assert choice[-1] == 0 and choice[0] is None
    coarse = Rule("", 1, coarse=True, margin=0.0).choose(tiles, still, (0.0, 0.5), factors)
    assert coarse == tuple(2 if place is None else 1 for place in choice)
    everything = Rule("", 0, margin=180.0, by_distance=True)
    assert [everything._rung(further, factors) for further in (1.0, 1.39, 1.4, 3.9, 9.0)] == [0, 0, 1, 1, 2]


def test_a_stock_counts_what_a_session_fetches():
    """All of a package in one rung, every time anew, but for its tables."""
    package = open_package(VALID / "two-groups-sh1")
    stock, m = Stock.of(package), package.manifest
    first = stock.bytes
    for turn in range(2):
        for segment in range(len(m.segments)):
            stock.fetch(turn, segment, (0, 0))
            stock.fetch(turn, segment, (0, 0))  # is there
    log = simulate(package, open_trace("const:100"), "fixed:0", SessionSettings(loops=2))
    tables = stock.catalogue.wire_bytes([m.groups.places.entry(g).file.bytes for g in range(len(m.groups))])
    assert stock.bytes - tables == log.metrics.wire_bytes
    assert first == stock.catalogue.wire_bytes([package.root_bytes])


def test_savings_are_at_equal_quality():
    rows = [
        {"rule": WHOLE, "psnr": 40.0, "bytes": 4000},
        {"rule": WHOLE, "psnr": 30.0, "bytes": 1000},
        {"rule": "x", "psnr": 35.0, "bytes": 1000},
        {"rule": "x", "psnr": 29.0, "bytes": 100},
    ]
    assert savings(rows)["x"] == [pytest.approx(0.5), None]
    assert savings(rows)[WHOLE] == pytest.approx([0, 0])


def test_the_bench_runs_and_says_what_was_seen(wide, tmp_path, capsys):
    words = [
        str(wide.folder),
        "-o",
        str(tmp_path),
        "--tiles",
        "2",
        "--seconds",
        "0.4",
        "--ticks",
        "1",
        "--segment",
        "0.1",
    ]
    assert bench_tiles.main(words) == 0
    out = capsys.readouterr().out.splitlines()
    rows = {line[:34].strip(): line.split() for line in reversed(out[1:])}
    whole, tiled = (float(rows[name][len(name.split()) + 3]) for name in ("whole", "all tiles"))
    assert whole > 30 and abs(whole - tiled) < 2  # dB
    assert with_background(open_package(tmp_path / "whole").manifest.region, (0.0, 0.0, 0.0)) == replace(
        open_package(tmp_path / "halves-01-of-02").manifest.region, source="cameras"
    )
