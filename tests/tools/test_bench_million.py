"""The benchmark of decoding a million Gaussians: on few of them, and what it has made once it does not make again."""

import pytest

from airgs_codec.scene.ply import write_ply
from tests.support.scenes import random_gaussians
from tools.bench_million import LOOPED, main


def test_every_part_of_every_scene_is_measured(tmp_path, capsys):
    fox = tmp_path / "fox"
    fox.mkdir()
    for t in range(LOOPED):
        write_ply(fox / f"{t:06d}.ply", random_gaussians(100, seed=1))
    words = [
        str(tmp_path / "out"),
        "--fox",
        str(fox),
        "--rows",
        "400",
        "--frames",
        "2",
        "--swing",
        "0.5",
        "--repeat",
        "1",
    ]
    main(words)
    rows = [line.strip("| ").split(" | ") for line in capsys.readouterr().out.splitlines()[2:]]
    assert len(rows) == 2 * 5
    assert all(float(row[6]) > 0 for row in rows if row[4] == "all")
    assert {row[0]: int(row[2]) for row in rows}["all swing by 0.5"] == pytest.approx(400, rel=0.1)
    made = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("airgs.json")}
    main(words)
    assert len(made) == 2 and made == {path: path.stat().st_mtime_ns for path in tmp_path.rglob("airgs.json")}
