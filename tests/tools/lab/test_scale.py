"""The benchmark of scale: what it fits."""

import pytest

from airgs_codec.scene.sequence import open_sequence
from tests.support.scenes import moving_frames, write_sequence
from tools.lab.bench.scale import STEPS, Measured, Options, fit_power, growth_words, run, scenes_of
from tools.lab.command import Lab
from tools.lab.made import forth_and_back


def test_a_power_law_is_found_again():
    a, k = fit_power([10, 100, 1000], [3 * size**1.25 for size in (10, 100, 1000)])
    assert (a, k) == (pytest.approx(3), pytest.approx(1.25))


def test_every_step_is_measured_in_a_process_of_its_own(tmp_path):
    page = run(Options(rows=(), frames=(2,), few=200), Lab.at(tmp_path))
    scenes, steps = page.tables()
    assert [(row["rows"], row["frames"], row["step"]) for row in steps.rows] == [(200, 2, step) for step in STEPS]
    assert all(row["cpu_seconds"] > 0 and row["peak_mb"] > 10 for row in steps.rows)
    assert len({row["frame_bytes"] for row in steps.rows}) == 1
    cold, warm, decode = steps.rows
    assert scenes.rows == [
        {"rows": 200, "frames": 2, "cold": cold["cpu_seconds"], "warm": warm["cpu_seconds"],
         "peak_mb": cold["peak_mb"], "kb_frame": cold["frame_bytes"] / 1e3, "decode_ms": 500 * decode["cpu_seconds"]}
    ]  # fmt: skip
    assert page.sections[0].answer == ""


@pytest.mark.parametrize(
    ("power", "words"),
    [
        (
            1.0,
            "Of CPU time, encoding takes 2.0 times as long for twice the Gaussians and 2.0 times for twice the frames.",
        ),
        (
            0.5,
            "Of CPU time, encoding takes 1.4 times as long for twice the Gaussians and 1.4 times for twice the frames.",
        ),
    ],
)
def test_growth_is_told_over_gaussians_and_over_frames(power, words):
    sizes = [(100, 30), (1000, 30), (20, 30), (20, 300)]
    found = [Measured(n, frames, "cold", 1.0, float(n * frames) ** power, 100.0, 50.0) for n, frames in sizes]
    assert growth_words(found, 20) == words
    assert [row["cold"] for row in scenes_of(found)] == [float(n * frames) ** power for n, frames in sizes]


def test_a_sequence_is_played_forth_and_back(tmp_path):
    scene = write_sequence(tmp_path / "scene", moving_frames(30, 3))
    forth_and_back(scene, 7, tmp_path / "long")
    assert [p.resolve().name for p in sorted((tmp_path / "long").iterdir())] == [
        open_sequence(scene).paths[i].name for i in (0, 1, 2, 1, 0, 1, 2)
    ]
