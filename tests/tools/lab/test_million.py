"""The benchmark of decoding a million Gaussians: on few of them, and what it has made once it does not make again."""

import pytest

from airgs_codec.scene.formats.ply import write_ply
from tests.support.scenes import random_gaussians
from tools.lab.bench.million import LOOPED, Options, run, words
from tools.lab.command import Lab


def test_every_scene_is_measured(tmp_path):
    fox = tmp_path / "fox"
    fox.mkdir()
    for t in range(LOOPED):
        write_ply(fox / f"{t:06d}.ply", random_gaussians(100, seed=1))
    options = Options(fox=fox, rows=400, frames=2, swings=(0.5,), repeat=1)
    (section,) = run(options, Lab.at(tmp_path / "out")).sections
    rows = section.tables[0].rows
    assert [row["package"] for row in rows] == ["ball, all swing by 0.5", "ring of 4 foxes"]
    assert all(row["ms a frame"] > 0 for row in rows) and rows[0]["with states"] == pytest.approx(400, rel=0.1)
    made = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("airgs.json")}
    run(options, Lab.at(tmp_path / "out"))
    assert len(made) == 2 and made == {path: path.stat().st_mtime_ns for path in tmp_path.rglob("airgs.json")}


@pytest.mark.parametrize(
    ("times", "said"),
    [
        (
            (50, 136),
            "Asked are at most 60 ms a frame, met where up to 33 % of the rows move (50 ms), not from 100 % on.",
        ),
        ((50, 58), "Asked are at most 60 ms a frame, met where up to 100 % of the rows move (58 ms)."),
        ((70, 136), "Asked are at most 60 ms a frame, which no scene meets: the quickest takes 70 ms."),
    ],
)
def test_what_is_asked_is_met_or_not(times, said):
    assert words([{"share": share, "ms a frame": ms} for share, ms in zip((0.33, 1.0), times, strict=True)]) == said
