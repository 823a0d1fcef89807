"""The benchmark of scale: what it fits."""

import pytest

from airgs_codec.scene.sequence import open_sequence
from tests.support.scenes import moving_frames, write_sequence
from tools.lab.bench.scale import STEPS, Measured, Options, fit_power, fit_words, fits_of, run
from tools.lab.command import Lab
from tools.lab.made import forth_and_back


def test_a_power_law_is_found_again():
    a, k = fit_power([10, 100, 1000], [3 * size**1.25 for size in (10, 100, 1000)])
    assert (a, k) == (pytest.approx(3), pytest.approx(1.25))
    assert fit_words([(10, 1.0), (100, 10.0)]) == "exponent 1.00, 10 to 100"
    assert fit_words([(10, 1.0)]) == "not measured"


def test_every_step_is_measured_in_a_process_of_its_own(tmp_path):
    page = run(Options(rows=(), frames=(2,), few=200), Lab.at(tmp_path))
    times, fits = page.sections[0].tables
    assert [(row["rows"], row["frames"], row["step"]) for row in times.rows] == [(200, 2, step) for step in STEPS]
    assert all(row["cpu_seconds"] > 0 and row["peak_mb"] > 10 for row in times.rows)
    assert len({row["frame_bytes"] for row in times.rows}) == 1
    assert [row["over frames"] for row in fits.rows] == ["not measured"] * len(STEPS)


def test_steps_are_fitted_over_gaussians_and_over_frames():
    sizes = [(100, 30), (1000, 30), (20, 30), (20, 300)]
    found = [Measured(rows, frames, "cold", 1.0, rows * frames / 100, 100.0, 50.0) for rows, frames in sizes]
    assert fits_of(found, 20)[0] == {
        "step": "cold", "over Gaussians": "exponent 1.00, 100 to 1,000", "over frames": "exponent 1.00, 30 to 300",
    }  # fmt: skip


def test_a_sequence_is_played_forth_and_back(tmp_path):
    scene = write_sequence(tmp_path / "scene", moving_frames(30, 3))
    forth_and_back(scene, 7, tmp_path / "long")
    assert [p.resolve().name for p in sorted((tmp_path / "long").iterdir())] == [
        open_sequence(scene).paths[i].name for i in (0, 1, 2, 1, 0, 1, 2)
    ]
