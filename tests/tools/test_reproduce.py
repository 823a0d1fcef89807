"""The paper's experiments: what is asked for is understood, streams are counted fairly, finished parts stay."""

from __future__ import annotations

import math

import numpy as np
import pytest

from airgs_codec.errors import ConfigError
from airgs_codec.play.frame_mode import CHOOSERS, push_frames
from airgs_codec.play.link import Link
from airgs_codec.play.trace import Trace
from tests.support.paths import FOX_VIEWS
from tests.support.training import SETTINGS
from tools.baselines.method import Frame
from tools.reproduce import main
from tools.reproduction.ablations import changes
from tools.reproduction.kept import KeptParts
from tools.reproduction.scenes import parse_subject
from tools.reproduction.streams import Level, Stream, spread_keys, stream_all
from tools.reproduction.training import Trained, row_of


def constant(rate_bps: float) -> Trace:
    return Trace("constant", np.array([0.0]), np.array([rate_bps]), 1000.0)


def frame(kind: str, size: int, psnr: float, seconds: float = 1.0) -> Frame:
    return Frame(kind, 10, size, seconds, psnr, 0.9)


def test_a_scene_is_a_name_a_folder_and_options():
    subject = parse_subject(f"fox={FOX_VIEWS},frames=2:5,size=64,near=0.5")
    assert (subject.name, subject.frames, subject.size, subject.near) == ("fox", (2, 5), 64, 0.5)
    scene = subject.open()
    assert len(scene) == 3
    assert {camera.near for camera in scene.cameras} == {0.5}
    quick = parse_subject(f"fox={FOX_VIEWS}").quick()
    assert (quick.frames, quick.size) == ((0, 4), 128)


@pytest.mark.parametrize("text", ["fox", "=x", "fox=x,sice=3", "fox=x,size=large", "fox=x,frames=b"])
def test_a_scene_that_is_not_said_right_is_refused(text, tmp_path, capsys):
    with pytest.raises(ConfigError):
        parse_subject(text)
    assert main(["-o", str(tmp_path), "--scene", text]) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_unknown_methods_and_parts_are_refused(tmp_path, capsys):
    assert main(["-o", str(tmp_path), "--methods", "airgs,best"]) == 2
    assert "got best" in capsys.readouterr().err
    assert main(["-o", str(tmp_path), "--only", "dance"]) == 2


def test_keys_are_spread_over_their_group_and_no_byte_is_lost():
    sizes = spread_keys([100, 10, 10, 200, 20], [True, False, False, True, False])
    assert sizes.sum() == pytest.approx(340)
    assert sizes[:3] == pytest.approx([40, 40, 40])
    assert sizes[3:] == pytest.approx([110, 110])
    alone = [30.0, 20.0]
    assert spread_keys(alone, [True, True]) == pytest.approx(alone)


def test_what_stands_on_the_screen_is_what_counts():
    psnr = np.array([[30.0, 20.0], [22.0, 31.0]])
    stream = Stream("m", "unpruned", (Level(0.0, np.array([100.0, 100.0]), psnr),))
    assert [[(o.size_bytes, o.quality) for o in frame] for frame in stream.options] == [[(100, 30.0)], [(100, 31.0)]]
    fast = push_frames(stream.options * 2, 10.0, Link(constant(1e9)), CHOOSERS["unpruned"])
    assert stream.table(fast)["psnr_screen"] == pytest.approx(30.5)
    slow = push_frames(stream.options * 2, 10.0, Link(constant(800 / 0.25)), CHOOSERS["unpruned"])  # 0.25 s a frame
    assert list(slow.shown) == [-1, -1, 0, 0]
    table = stream.table(slow)
    assert table["psnr_screen"] == pytest.approx((30 + 20) / 2)
    assert table["blank"] == 0.5


def test_a_stream_of_which_nothing_fits_has_no_times():
    stream = Stream("m", "paper-no-cliff", (Level(0.0, np.array([1e6, 1e6]), np.full((2, 2), 30.0)),))
    (row,) = stream_all([stream], [constant(8e3)], 1, 10.0)
    assert row["skipped"] == 1 and row["kb_frame"] == 0
    assert math.isnan(row["worst_ms"]) and math.isnan(row["psnr"]) and np.isnan(row["percentiles_ms"]).all()


def test_a_row_says_the_worst_frame_and_the_keyframes_after_the_first():
    frames = (frame("key", 900, 30.0, 50.0), frame("frame", 100, 28.0), frame("key", 500, 32.0, 10.0))
    row = row_of(Trained("s", "m", frames, 12.0))
    assert (row.psnr, row.worst, row.most_deviation, row.key_s) == (30.0, 28.0, 2.0, 10.0)
    assert row.deviation == pytest.approx(4 / 3)
    assert row.kb_frame == 0.5
    assert row_of(Trained("s", "m", frames[:2], 12.0)).key_s is None


def test_a_finished_part_is_made_again_only_for_another_key(tmp_path):
    made: list[float] = []

    def make() -> list[float]:
        made.append(math.nan if len(made) else 1.0)
        return [made[-1]]

    kept = KeptParts(tmp_path / "parts")
    assert kept.get("a", {"x": np.float64(1).item()}, make) == [1.0]
    assert kept.get("a", {"x": 1.0}, make) == [1.0]
    assert len(made) == 1
    assert kept.get("a", {"x": 2.0}, make) == [None]
    assert len(made) == 2


def test_every_ablation_changes_something():
    base = SETTINGS
    all_of_them = changes(base)
    assert all_of_them[0].settings == base
    assert all(change.settings != base for change in all_of_them[1:])
    assert len({(c.question, c.name) for c in all_of_them}) == len(all_of_them)
