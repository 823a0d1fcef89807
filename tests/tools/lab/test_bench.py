"""Benchmarks on the least that shows that they work: rows with figures in them, and no errors."""

import numpy as np
import pytest

from airgs_codec.media.metrics import psnr
from tests.support.paths import FOX, GOLDEN
from tests.support.scenes import moving_frames, write_sequence
from tools.lab.bench import engines, link, omissions, viewpoints
from tools.lab.command import Lab

PACKAGE = GOLDEN / "fox"


def rows_of(page):
    return [list(table.rows) for section in page.sections for table in section.tables]


def test_a_real_session_is_compared_with_a_simulated_one(tmp_path):
    ((row,),) = rows_of(link.run(link.Options(PACKAGE, ("const:5",), seconds=0.2), Lab.at(tmp_path)))
    assert 0 < row["same batches"] <= row["of"] and row["PSNR, dB"] > 30 and row["worst"] >= row["arrivals off, mean"]


def test_found_viewpoints_are_compared_with_true_ones(tmp_path):
    options = viewpoints.Options((f"{FOX}={FOX / 'transforms.json'}",))
    ((row,),) = rows_of(viewpoints.run(options, Lab.at(tmp_path)))
    assert row["scene"] == "fox" and (tmp_path / "fox.png").stat().st_size
    assert 0 <= row["away"] <= row["worst_away"] and 0 <= row["degrees"] <= row["worst_degrees"] <= 180


def test_answers_about_viewpoints_are_those_of_the_rows():
    one = {"scene": "a", "sure": True, "away": 0.2, "degrees": 19.6, "worst_away": 0.5, "worst_degrees": 20.0}
    other = {"scene": "b", "sure": True, "away": 0.31, "degrees": 11.0, "worst_away": 0.4, "worst_degrees": 61.0}
    words = viewpoints.page([one, other, {"scene": "c", "sure": False}]).sections[0].answer
    assert words == (
        "From a true camera to the nearest found one it is 0.20 to 0.31 of the distance to what it sees, and 11 to 20 "
        "degrees (medians of a and b; at worst 0.50 and 61). Of c it says that it is not sure."
    )
    assert viewpoints.page([one]).sections[0].answer.endswith("It is sure of every scene.")
    assert viewpoints.page([{"scene": "c", "sure": True}]).sections[0].answer == "It is sure of every scene."


def test_scenes_for_engines_are_balls_or_packages():
    ball, package = (engines.read_scene(name, 50, 0) for name in ("ball-1", str(PACKAGE)))
    assert len(ball.gaussians) == 50 and ball.gaussians.sh_degree == 1 and len(ball.views) == len(package.views) == 4
    assert len(engines.columns(ball.gaussians)) == 4 * 50 * (3 + 4 + 3 + 1 + 12)
    rows = [
        {"scene": "a", "engine": "spark", "tuned": 53.0, "tuned_close": 51.2, "default": 35.0, "default_close": 37.0},
        {"scene": "a", "engine": "other", "tuned": 49.0, "tuned_close": 50.0, "default": 52.0, "default_close": 51.0},
    ]
    assert engines.page(rows, "").sections[0].answer == (
        "As the adapters set them, engines show every picture with at least 51.2 (spark) and 49.0 (other) dB against "
        "our renderer; as they come, with 35.0 (spark) and 51.0 (other)."
    )
    picture = np.full((2, 2, 3), 255, np.uint8)
    assert engines._psnr(picture, picture - 51) == pytest.approx(psnr(0.04))


def test_what_is_left_out_is_taken_back_one_by_one(tmp_path, monkeypatch):
    """Without states that are still or rows that nobody sees a small scene takes more bytes, and shows no less."""
    frames = moving_frames(300, 3, 1)
    scene = write_sequence(tmp_path / "scene", frames)
    taken_back = {
        name: omissions.TAKEN_BACK[name] for name in (omissions.AS_IT_IS, "rows that nobody sees", "planes", "segments")
    }
    monkeypatch.setattr(omissions, "TAKEN_BACK", taken_back)
    options = omissions.Options((str(scene),), x264_preset="ultrafast")
    (rows,) = rows_of(omissions.run(options, Lab.at(tmp_path / "out", quiet=True)))
    assert rows[0]["taken_back"] == omissions.AS_IT_IS and rows[0]["more"] == rows[0]["gained"] == 0
    assert all(row["scene"] == "scene" and row["psnr"] > 20 for row in rows)
    with_all = rows[0] | {"taken_back": "planes", "more": 3.0, "gained": -0.1}
    assert "planes saves most: with them" in omissions.answer([rows[0], with_all])
    assert omissions.answer(rows[:1]) == "Nothing is left out."
