"""The tools that measure and torment shared work, on very little of it."""

import json

import pytest

pytest.importorskip("distributed", reason="Dask, the extra `farm`, is not installed")

from tools import bench_jobs, soak_farm


def test_two_workers_eight_jobs_and_a_few_failures_end_with_the_same_bytes(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(soak_farm, "PAUSE_S", 0.5)
    monkeypatch.setattr(soak_farm, "ROWS", 200)
    assert soak_farm.main(["-o", str(tmp_path / "out"), "--groups", "2", "--kills", "4", "--seed", "1"]) == 0
    found = json.loads((tmp_path / "out" / "soak.json").read_text())
    assert found["same_bytes"] and found["jobs"] >= 8 and sum(found["failures"].values()) >= 4
    assert "Traceback" not in (tmp_path / "out" / "runs.log").read_text()
    assert "<svg" in (tmp_path / "out" / "jobs.html").read_text()
    assert soak_farm.main(["-o", str(tmp_path / "out")]) == 2
    assert "expected a new folder" in capsys.readouterr().err


def test_ways_to_share_work_are_timed(tmp_path, capsys):
    words = ["-o", str(tmp_path), "--frames", "20", "--rows", "100", "--jobs", "2", "--seconds", "0.1"]
    assert bench_jobs.main(words) == 0
    lines = (tmp_path / "jobs.csv").read_text().splitlines()
    assert len(lines) == 1 + 3 + 2 and "Dask, two workers" in capsys.readouterr().out
