"""The rivals' settings are those that run, and what is said of V^3's layouts is what was measured."""

import pytest

from tests.support.paths import FOX
from tools.lab import Lab
from tools.lab.baselines import rivals
from tools.lab.baselines.v3 import V3Settings


def row(scene, qp, activated, stored):
    return {"scene": scene, "qp": qp, "activated_db": activated, "stored_db": stored}


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        ([row("fox", 6, 48, 49.9), row("fox", 22, 41.5, 41.45)], "the stored one on fox (by up to 1.9 dB)."),
        ([row("head", 6, 53.1, 49.5)], "the activated one on head (by up to 3.6 dB)."),
        ([row("fox", 6, 48, 49), row("fox", 22, 41.5, 41)], "now one, now the other on fox."),
        (
            [row("fox", 6, 48, 49), row("head", 6, 53, 49), row("spinach", 6, 9, 40)],
            "the stored one on fox (by up to 1.0 dB) and spinach (by up to 31.0 dB) and "
            "the activated one on head (by up to 4.0 dB).",
        ),
    ],
)
def test_the_better_layout_is_told_for_each_scene(rows, said):
    assert rivals.verdict(rows).endswith(f"is {said}")


def test_settings_are_those_that_run():
    found = {(method, what): (here, paper) for method, what, here, paper in rivals.settings_of()}
    v3 = V3Settings()
    assert found["V³", "iterations of a keyframe"] == (v3.key_iterations + v3.finetune_iterations, 16_000)
    assert found["naive 3DGS", "gradient from which Gaussians are added"] == (4e-4, 2e-4)
    assert [rivals.shown(value) for value in (4e-4, 16_000, "all", 3.0)] == ["0.0004", "16,000", "all", "3"]


def test_both_layouts_are_measured_on_a_scene(tmp_path):
    scene = f"{FOX}={FOX / 'transforms.json'}"
    page = rivals.run(rivals.Options((scene,), qps=(6, 22), frames=2), Lab.at(tmp_path, quiet=True))
    fine, coarse = page.tables()[1].rows
    for form in ("activated", "stored"):
        assert fine[f"{form}_db"] > coarse[f"{form}_db"] + 2 and fine[f"{form}_kb"] > coarse[f"{form}_kb"]
    assert abs(fine["stored_db"] - fine["activated_db"]) > 0.1  # they are not the same one
