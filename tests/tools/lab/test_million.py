"""The benchmark of decoding a million Gaussians: on few of them, and what it has made once it does not make again."""

import pytest

from airgs_codec.scene.formats.ply import write_ply
from tests.support.scenes import random_gaussians
from tools.lab.bench.million import LOOPED, Options, run
from tools.lab.command import Lab


def test_every_part_of_every_scene_is_measured(tmp_path):
    fox = tmp_path / "fox"
    fox.mkdir()
    for t in range(LOOPED):
        write_ply(fox / f"{t:06d}.ply", random_gaussians(100, seed=1))
    options = Options(fox=fox, rows=400, frames=2, swing=0.5, repeat=1)
    (section,) = run(options, Lab.at(tmp_path / "out")).sections
    rows = section.tables[0].rows
    assert len(rows) == 2 * 8
    assert all(row["ms a frame"] > 0 for row in rows if row["part"] == "all")
    states = {row["package"]: row["with states"] for row in rows}
    assert states["all swing by 0.5"] == pytest.approx(400, rel=0.1)
    made = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("airgs.json")}
    run(options, Lab.at(tmp_path / "out"))
    assert len(made) == 2 and made == {path: path.stat().st_mtime_ns for path in tmp_path.rglob("airgs.json")}
