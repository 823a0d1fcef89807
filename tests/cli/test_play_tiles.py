"""airgs-play on a package in tiles."""

import json
import shutil
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from airgs_codec.cli.play import main
from airgs_codec.decoder.decode import Part, decode_frames
from airgs_codec.media.image import to_bytes
from airgs_codec.package.package import find_faults, open_package
from airgs_codec.package.viewpath import path_of_region
from airgs_codec.play.offers import Offers
from airgs_codec.play.report import film
from airgs_codec.play.session import simulate
from airgs_codec.play.settings import SessionSettings
from airgs_codec.play.trace import Trace
from airgs_codec.render.backend import CPU
from airgs_codec.scene.gaussians import join_rows
from tests.support.manifests import missing
from tests.support.paths import GOLDEN, VALID
from tests.support.servers import plainly_serving
from tests.support.tiled import Turning, tiled_manifest

PACKAGE = GOLDEN / "tiles"
OPTIONS = ["--policy", "fixed:0", "--player.loops", "2", "--json"]


def play(capsys, *options, trace="const:8"):
    assert main([str(PACKAGE), "--trace", trace, *OPTIONS, *map(str, options)]) == 0
    return json.loads(capsys.readouterr().out)


def test_all_of_a_scene_is_fetched_unless_told_otherwise(capsys):
    whole, by_view = play(capsys), play(capsys, "--view-adaptive")
    m = open_package(PACKAGE).manifest
    assert whole["tiles"] is None and by_view["tiles"]["tiles"] == m.tiles == len(by_view["tiles"]["bytes"])
    assert 0 < by_view["tiles"]["fetched"] <= 1 and by_view["tiles"]["missing_s"] == 0
    assert sum(by_view["tiles"]["bytes"]) == sum(by_view["bytes"][kind] for kind in ("key", "sidecars", "state"))


def test_over_http_the_same_tiles_are_fetched(capsys, tmp_path):
    with plainly_serving(PACKAGE) as port:
        words = [f"http://127.0.0.1:{port}/", "--http.as-fast", *OPTIONS, "--view-adaptive"]
        assert main([*words, "--report", str(tmp_path / "report"), "--video", str(tmp_path / "seen.mp4")]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["tiles"]["tiles"] == open_package(PACKAGE).manifest.tiles and result["lost"] == []
    assert (tmp_path / "seen.mp4").stat().st_size > 0
    assert "in sight was lacking for" in (tmp_path / "report" / "index.html").read_text()


def test_a_package_of_one_tile_is_played_as_ever(capsys):
    words = [str(VALID / "two-groups-sh1"), "--trace", "const:8", *OPTIONS]
    outs = []
    for options in ([], ["--view-adaptive"]):
        assert main([*words, *options]) == 0
        outs.append(capsys.readouterr().out)
    assert outs[0] == outs[1]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--compare", "--traces", "const:1"], "--view-adaptive: expected a single session"),
        (["--trace", "const:1", "--player.view-buffer", "0"], "buffer by view: expected more than 0 s"),
    ],
)
def test_bad_options_are_one_line_and_2(capsys, options, words):
    assert main([str(PACKAGE), "--view-adaptive", *options]) == 2
    captured = capsys.readouterr()
    assert captured.out == "" and words in captured.err and captured.err.count("\n") == 1


def test_the_screen_shows_the_tiles_that_had_come():
    """Of a viewer who turns on a slow link: at every tick the rows of those tiles, and no others."""
    package = open_package(PACKAGE)
    log = simulate(package, Trace.open("const:3"), "fixed:0", SessionSettings(loops=1), view=Turning(300, 0.1))
    m = package.manifest
    alone = {
        tile: list(decode_frames(package, 0, m.frames, part=Part(tiles=[tile])))
        for tile in range(m.tiles)
        if any(tier.count for tier in m.groups[0].tiles[tile].tiers)
    }
    seen = set()
    for tick, (shown, entry) in enumerate(film.screen_frames(package, log)):
        there = log.tiles.there(entry, float(log.tiles.tick_times[tick]))
        frame = m.segments[log.shown[entry].segment].start + log.screen_ticks[tick][1]
        wanted = join_rows([alone[tile][frame].gaussians for tile in sorted(there)])
        np.testing.assert_array_equal(shown.means, wanted.means)
        seen.add(tuple(sorted(there)))
    assert seen


def test_a_tile_that_is_missing_costs_no_other():
    package = open_package(PACKAGE)
    faults = missing("key/P3/T0/1.bin")
    log = simulate(
        package,
        Trace.open("const:8"),
        "fixed:0",
        SessionSettings(loops=1),
        faults,
        path_of_region(package.manifest.region),
    )
    assert log.metrics.lost_frames == 0
    assert {event.tile for event in log.tiles.ready} == {0, 1}


def test_the_still_has_every_tile_in_its_own_rung(tmp_path, monkeypatch):
    """The first tile came in the better keys, before those of another were found missing."""
    root = shutil.copytree(PACKAGE, tmp_path / "package")
    m = open_package(root).manifest
    settings, view = SessionSettings(loops=1), path_of_region(m.region)
    whole = simulate(open_package(root), Trace.open("const:8"), "fixed:0", settings, view=view)
    last = whole.tiles.came(0)[-1].tile
    (root / m.key_files(0, last * m.tiers, 0)[1]).unlink()
    package = open_package(root)
    log = simulate(package, Trace.open("const:8"), "fixed:0", settings, find_faults(package), view)
    assert len({event.rung for event in log.tiles.came(0)}) == 2
    monkeypatch.setattr(film, "label", lambda picture, *_: picture)
    shown = next(film.screen_frames(package, log))[0]
    camera = replace(view.at(0.0), width=96, height=64)
    monkeypatch.setattr(film, "_goodness", lambda s: s.start_s)
    seen = film.still(package, log, camera)[:, camera.width :]
    np.testing.assert_array_equal(seen, to_bytes(CPU.render(shown, camera).rgb))


def test_a_scene_without_rows_is_an_empty_picture():
    m = tiled_manifest(4, empty=range(4))
    log = simulate(Offers(m, 0, 1000), Trace.open("const:8"), "fixed:0", SessionSettings(loops=1), view=Turning())
    frames = [shown for shown, _ in film.screen_frames(SimpleNamespace(manifest=m), log)]
    assert len(frames) == m.frames
    assert {(len(shown), shown.sh_degree) for shown in frames} == {(0, m.sh_degree)}
    assert not CPU.render(frames[0], Turning().at(0.0)).rgb.any()


def test_a_budget_counts_all_tiles(capsys):
    m = open_package(PACKAGE).manifest
    fewest = m.groups[0].count
    assert play(capsys, "--player.budget", fewest, "--view-adaptive")["gaussians"] <= fewest
