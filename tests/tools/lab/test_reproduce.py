"""The paper's experiments: what is asked for is understood, streams are counted fairly, finished parts stay."""

from __future__ import annotations

import math
from functools import partial

import numpy as np
import pytest
from tools.lab.paper.frames import CHOOSERS, SKIPPED, frame_options, push_frames

from airgs_codec.errors import ConfigError
from airgs_codec.package.package import open_package
from airgs_codec.play.offers import Offers
from airgs_codec.play.trace import Link, Trace
from airgs_codec.trainer.data.readers import open_scene
from tests.support.paths import FOX, FOX_VIEWS, VALID
from tests.support.training import SETTINGS
from tools.lab import main
from tools.lab.baselines.method import Frame
from tools.lab.command import Lab
from tools.lab.page import Picture, write_picture
from tools.lab.paper import reproduce
from tools.lab.paper.footage import Options, run
from tools.lab.paper.pictures import draw_ablations, draw_times
from tools.lab.paper.reproduce import quality
from tools.lab.paper.streams import Level, Stream, saved_by_level, spread_keys, stream, streams_of
from tools.lab.paper.training import METHODS, Trained, changes, parse_subject, row_of


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
    other = parse_subject(f"fox={FOX_VIEWS},held={scene.cameras[0].name}+{scene.cameras[1].name}")
    assert [camera.held_out for camera in other.open().cameras[:3]] == [True, True, False]
    assert other.words() != subject.words() and other.quick().held == other.held
    quick = parse_subject(f"fox={FOX_VIEWS}").quick()
    assert (quick.frames, quick.size) == ((0, 4), 128)


@pytest.mark.parametrize("text", ["fox", "=x", "fox=x,sice=3", "fox=x,size=large", "fox=x,frames=b"])
def test_a_scene_that_is_not_said_right_is_refused(text, tmp_path, capsys):
    with pytest.raises(ConfigError):
        parse_subject(text)
    assert main(["reproduce", "-o", str(tmp_path), "--scenes", text]) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_unknown_methods_and_parts_are_refused(tmp_path, capsys):
    assert main(["reproduce", "-o", str(tmp_path), "--methods", "airgs", "best"]) == 2
    assert "got best" in capsys.readouterr().err
    assert main(["reproduce", "-o", str(tmp_path), "--only", "dance"]) == 2


def test_keys_are_spread_over_their_group_and_no_byte_is_lost():
    sizes = spread_keys([100, 10, 10, 200, 20], [True, False, False, True, False])
    assert sizes.sum() == pytest.approx(340)
    assert sizes[:3] == pytest.approx([40, 40, 40])
    assert sizes[3:] == pytest.approx([110, 110])
    alone = [30.0, 20.0]
    assert spread_keys(alone, [True, True]) == pytest.approx(alone)


def test_what_stands_on_the_screen_is_what_counts():
    psnr = np.array([[30.0, 20.0], [22.0, 31.0]])
    stream = Stream("m", "unpruned", (Level(np.array([100.0, 100.0]), np.zeros(2), psnr),))
    assert [[(o.size_bytes, o.quality) for o in frame] for frame in stream.options] == [[(100, 30.0)], [(100, 31.0)]]
    fast = push_frames(stream.options * 2, 10.0, Link(constant(1e9)), CHOOSERS["unpruned"])
    assert stream.table(fast)["psnr_screen"] == pytest.approx(30.5)
    slow = push_frames(stream.options * 2, 10.0, Link(constant(800 / 0.25)), CHOOSERS["unpruned"])  # 0.25 s a frame
    assert list(slow.shown) == [-1, -1, 0, 0]
    table = stream.table(slow)
    assert table["psnr_screen"] == pytest.approx((30 + 20) / 2)
    assert table["blank"] == 0.5


def test_a_stream_of_which_nothing_fits_has_no_times():
    one = Stream("m", "paper-no-cliff", (Level(np.array([1e6, 1e6]), np.zeros(2), np.full((2, 2), 30.0)),))
    row = stream(one, [constant(8e3)], 1, 10.0)
    assert row["skipped"] == 1 and row["kb_frame"] == 0
    assert math.isnan(row["worst_ms"]) and math.isnan(row["psnr"]) and np.isinf(row["percentiles_ms"]).all()


def test_a_row_says_the_worst_frame_and_the_keyframes_after_the_first():
    frames = (frame("key", 900, 30.0, 50.0), frame("frame", 100, 28.0), frame("key", 500, 32.0, 10.0))
    row = row_of(Trained("s", "m", frames, 12.0), 25.0)
    assert tuple(row[name] for name in ("psnr", "worst", "most_deviation", "key_s")) == (30.0, 28.0, 2.0, 10.0)
    assert row["deviation"] == pytest.approx(4 / 3)
    assert row["kb_frame"] == 0.5 and row["mbit_s"] == pytest.approx(0.1)
    assert row_of(Trained("s", "m", frames[:2], 12.0), 25.0)["key_s"] is None


def test_levels_save_shares_of_bytes_as_players_count_them():
    """The cliff of a stream is the product's: before, it was looked for in the shares of updates that are withheld."""
    package = open_package(VALID / "moving")
    m = package.manifest
    saved = saved_by_level(m)
    by_player = [[option.saved for option in levels] for levels in frame_options(Offers(m), keys=False)]
    np.testing.assert_array_equal(saved.T, by_player)
    assert saved[1:].max() > 0 and not np.allclose(saved[-1], m.levels[-1].pruned)
    t = np.array([1000.0])
    levels = tuple(
        Level(size * t, np.array([share]), np.array([[psnr]]))
        for size, share, psnr in ((1, 0.0, 40.0), (0.5, 0.5, 38.0), (0.4, 0.6, 30.0))
    )
    assert [option.saved for option in Stream("airgs", "paper", levels).options[0]] == [0.0, 0.5, 0.6]
    assert CHOOSERS["paper"](Stream("airgs", "paper", levels).options[0], 450.0) == (SKIPPED, False)  # past the cliff


def test_methods_skip_where_no_other_frame_needs_the_frame():
    level = (Level(np.array([1e6]), np.zeros(1), np.full((1, 1), 30.0)),)
    choosers = {method: [one.chooser for one in streams_of(method, level)] for method in METHODS}
    assert choosers["naive3dgs"] == ["unpruned", "paper-no-cliff"] and choosers["v3"] == ["unpruned"]
    assert choosers["airgs"] == choosers["airgs-paper"] == ["unpruned", "paper", "paper-no-cliff", "paper-literal"]


def test_every_ablation_changes_something():
    base = SETTINGS
    all_of_them = changes(base)
    assert all_of_them[0].settings == base
    assert all(change.settings != base for change in all_of_them[1:])
    assert len({(c.question, c.name) for c in all_of_them}) == len(all_of_them)


def test_pictures_of_a_sequence_are_a_scene_to_train_on(tmp_path):
    made = run(Options(FOX, frames="0:1", max_size=24, points=50), Lab.at(tmp_path, quiet=True))
    scene = open_scene(tmp_path / "footage")
    assert len(scene) == 1 and "1 frames" in made.sections[0].answer
    assert max(scene.cameras[0].width, scene.cameras[0].height) == 24
    assert scene.points is not None and len(scene.points.positions) == 50


def test_pictures_are_drawn_of_what_there_is(tmp_path, monkeypatch):
    """Also where a frame never came, and where an ablation failed."""
    frames = (frame("key", 900, 30.0), frame("frame", 100, 28.0))
    trained = [Trained(scene, method, frames, 12.0) for scene in ("a", "b") for method in ("airgs", "naive3dgs")]
    level = (Level(np.array([1e4, 1e6]), np.zeros(2), np.full((2, 2), 30.0)),)
    times = [{"scene": "a"} | stream(one, [constant(8e5)], 1, 10.0) for one in streams_of("naive3dgs", level)]
    assert np.isinf(times[1]["percentiles_ms"][-1])
    ablated = [{"question": "", "name": "as it is", "psnr": 30.0, "kb_frame": 9.0}]
    ablated += [{"question": "q", "name": n, "psnr": v, "kb_frame": v} for n, v in (("x", 29.0), ("y", math.nan))]
    monkeypatch.setattr(
        reproduce, "side_by_side", lambda *_: {name: np.random.default_rng(1).random((64, 64, 3)) for name in METHODS}
    )
    lab = Lab.at(tmp_path / "lab", quiet=True)
    scenes = [parse_subject(f"{scene}={FOX_VIEWS}") for scene in ("a", "b")]
    assert len(quality(scenes, trained, lab, reproduce.Options()).pictures) == 2
    section = quality(scenes, trained, lab, reproduce.Options(show=("a",)))
    assert len(section.pictures) == 3
    drawn = [*section.pictures, Picture("times", "", partial(draw_times, times))]
    for picture in (*drawn, Picture("ablations", "", partial(draw_ablations, ablated))):
        write_picture(picture, tmp_path / f"{picture.name}.png")
        assert (tmp_path / f"{picture.name}.png").stat().st_size > 5_000
    assert [row["kb_frame"] for row in section.tables[0].rows] == [0.5] * 4


def method(name, psnr, kb, scene="fox"):
    return {"scene": scene, "method": name, "psnr": psnr, "kb_frame": kb}


def test_words_on_methods_follow_from_their_rows():
    rows = [
        method("airgs", 33.95, 10.0),
        method("airgs-paper", 39.0, 1.0),
        method("v3", 28.0, 45.0),
        method("4dgs", 34.0, 300.0),
    ]
    assert reproduce.in_words(rows) == (
        "On fox airgs has 33.95 dB, 0.05 dB under 4dgs, the best of the others, with 30.0 times fewer bytes; v3, the "
        "smallest of them, takes 4.5 times as many for 28.00 dB. airgs-paper has 39.00 dB at 1.0 kB a frame."
    )
    assert "0.95 dB above 4dgs" in reproduce.in_words([*rows[:3], method("4dgs", 33.0, 300.0)])
    assert reproduce.in_words(rows[:2]) == ""


def test_words_on_streams_follow_from_their_rows():
    rows = [
        {"scene": "fox", "method": name, "chooser": chooser, "psnr_screen": psnr}
        for name, chooser, psnr in (
            ("airgs", "paper", 32.0),
            ("airgs-paper", "unpruned", 31.0),
            ("v3", "unpruned", 33.0),
            ("4dgs", "unpruned", math.nan),
        )
    ]
    words = reproduce.streamed_in_words(rows, 30)
    assert words == "Over 30 traces. fox: airgs by paper shows 32.00 dB, v3, the best of the others, 33.00."
