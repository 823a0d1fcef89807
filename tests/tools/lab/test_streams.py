"""Streams of the paper are counted fairly: keys are spread, what stands on the screen counts, cliffs are ours."""

import numpy as np
import pytest

from airgs_codec.errors import ConfigError
from airgs_codec.package.package import open_package
from airgs_codec.play.ladder import saved_shares
from airgs_codec.play.trace import Link, Trace
from tests.support.paths import FOX_VIEWS, VALID
from tools.lab import main
from tools.lab.baselines.airgs import fetched_bytes, key_bytes
from tools.lab.paper.streams import (
    CHOOSERS,
    SKIPPED,
    Level,
    Stream,
    push_frames,
    saved_by_level,
    spread_keys,
    streams_of,
)
from tools.lab.paper.training import METHODS, parse_subject


def constant(rate_bps):
    return Trace("constant", np.array([0.0]), np.array([rate_bps]), 1000.0)


def test_a_scene_is_a_name_a_folder_and_options():
    subject = parse_subject(f"fox={FOX_VIEWS},frames=2:5,size=64,near=0.5")
    assert (subject.name, subject.frames, subject.size, subject.near) == ("fox", (2, 5), 64, 0.5)
    scene = subject.open()
    assert len(scene) == 3 and {camera.near for camera in scene.cameras} == {0.5}
    other = parse_subject(f"fox={FOX_VIEWS},held={scene.cameras[0].name}+{scene.cameras[1].name}")
    assert [camera.held_out for camera in other.open().cameras[:3]] == [True, True, False]
    assert other.words() != subject.words() and other.quick().held == other.held


@pytest.mark.parametrize("text", ["fox", "=x", "fox=x,sice=3", "fox=x,size=large", "fox=x,frames=b"])
def test_a_scene_that_is_not_said_right_is_refused(text, tmp_path, capsys):
    with pytest.raises(ConfigError):
        parse_subject(text)
    assert main(["reproduce", "-o", str(tmp_path), "--scenes", text]) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_keys_are_spread_over_their_group_and_no_byte_is_lost():
    sizes = spread_keys([100, 10, 10, 200, 20], [True, False, False, True, False])
    assert sizes == pytest.approx([40, 40, 40, 110, 110])
    assert spread_keys([30.0, 20.0], [True, True]) == pytest.approx([30.0, 20.0])


def test_what_stands_on_the_screen_is_what_counts():
    psnr = np.array([[30.0, 20.0], [22.0, 31.0]])
    one = Stream("m", "unpruned", (Level(np.array([100.0, 100.0]), np.zeros(2), psnr),))
    fast = push_frames(one.options * 2, 10.0, Link(constant(1e9)), CHOOSERS["unpruned"])
    assert one.table(fast)["psnr_screen"] == one.table(fast)["psnr"] == pytest.approx(30.5)
    slow = push_frames(one.options * 2, 10.0, Link(constant(800 / 0.25)), CHOOSERS["unpruned"])  # 0.25 s a frame
    assert list(slow.shown) == [-1, -1, 0, 0]
    table = one.table(slow)
    assert (table["blank"], table["stale"], table["late"]) == (0.5, 0.5, 1.0)
    assert table["psnr_screen"] == pytest.approx((30 + 20) / 2) and table["mean_ms"] == pytest.approx(250)


def test_levels_save_shares_of_bytes_as_players_count_them():
    m = open_package(VALID / "moving").manifest
    saved = saved_by_level(m)
    for segment in m.segments:
        shares = saved_shares([level.file.bytes for level in segment.levels])
        np.testing.assert_array_equal(saved[:, segment.start], shares)
    assert saved[1:].max() > 0 and not np.allclose(saved[-1], m.levels[-1].pruned)
    levels = tuple(
        Level(np.array([size]), np.array([share]), np.array([[psnr]]))
        for size, share, psnr in ((1000.0, 0.0, 40.0), (500.0, 0.5, 38.0), (400.0, 0.6, 30.0))
    )
    options = Stream("airgs", "paper", levels).options[0]
    assert CHOOSERS["paper"](options, 450.0) == (SKIPPED, False)  # past the cliff
    assert CHOOSERS["paper-no-cliff"](options, 450.0) == (2, True)
    assert CHOOSERS["unpruned"](options, 450.0) == (0, False)


def test_methods_skip_where_no_other_frame_needs_the_frame():
    level = (Level(np.array([1e6]), np.zeros(1), np.full((1, 1), 30.0)),)
    choosers = {method: [one.chooser for one in streams_of(method, level)] for method in METHODS}
    assert choosers["naive3dgs"] == ["unpruned", "paper-no-cliff"] and choosers["v3"] == ["unpruned"]
    assert choosers["airgs"] == choosers["airgs-paper"] == ["unpruned", "paper", "paper-no-cliff", "paper-literal"]


@pytest.mark.parametrize("name", ["kept", "moving", "one-gaussian", "paged", "two-groups-sh1"])
def test_bytes_of_frames_are_all_that_a_viewer_of_the_top_rung_fetches(name):
    package = open_package(VALID / name)
    m = package.manifest
    tables = [path for path in sorted((VALID / name).rglob("*")) if path.name in ("airgs.json", "manifest.mpd")]
    listed = {*m.rung_files(0, 0), *m.table_files(), "init.mp4"}
    sizes = fetched_bytes(package)
    assert len(sizes) == m.frames
    assert sum(sizes) == sum(p.stat().st_size for p in [*tables, *(VALID / name / path for path in listed)])
    assert all(sizes[group.start] >= key_bytes(m, number, 0) for number, group in enumerate(m.groups))
