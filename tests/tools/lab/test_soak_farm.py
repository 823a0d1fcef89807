"""The tool that torments shared work, on very little of it."""

import pytest

pytest.importorskip("distributed", reason="Dask, the extra `farm`, is not installed")

from tools.lab.soak import farm

from airgs_codec.errors import ConfigError
from tools.lab.command import Lab


def test_two_workers_four_jobs_and_a_few_failures_end_with_the_same_bytes(tmp_path, monkeypatch):
    monkeypatch.setattr(farm, "PAUSE_S", 0.5)
    monkeypatch.setattr(farm, "ROWS", 200)
    lab = Lab.at(tmp_path / "out")
    page = farm.run(farm.Options(groups=1, kills=2, seed=1), lab)
    (row,) = page.sections[0].tables[0].rows
    assert row["same bytes"] and not page.failed and row["jobs"] >= 4 and row["made"] >= 2
    assert "Traceback" not in (tmp_path / "out" / "runs.log").read_text()
    assert "<svg" in (tmp_path / "out" / "jobs.html").read_text()
    with pytest.raises(ConfigError, match="expected a new folder"):
        farm.run(farm.Options(), lab)
