"""Runs of other methods over a link, in frame mode."""

import json
from dataclasses import asdict

import numpy as np
import pytest

from airgs_codec.errors import ConfigError
from airgs_codec.play.link import Link
from airgs_codec.play.trace import Trace
from tools.baselines.method import RECORD, Frame
from tools.baselines.stream import main, read_frames, stream

FRAMES = [Frame("key" if t == 0 else "frame", 10, size, 1.0, 40.0 - t, 0.9) for t, size in enumerate((5000, 1000, 500))]


def test_every_frame_is_sent_over_and_over():
    """1000 B in 80 ms: the key takes 400 ms, and every third frame is one."""
    table = stream(FRAMES, 10.0, Link(Trace("t", np.zeros(1), np.array([1e5]), 1000.0), 0.0))
    assert table["frames"] == 300 and table["skipped"] == 0
    assert table["paper_mean_ms"] == pytest.approx((400 + 80 + 40) / 3) and table["paper_max_ms"] == pytest.approx(400)
    assert table["psnr"] == pytest.approx(39.0) and table["late"] == 1.0  # 520 ms of data every 300 ms


def test_runs_are_read_from_their_folders(tmp_path, capsys):
    run = tmp_path / "v3"
    run.mkdir()
    with pytest.raises(ConfigError, match="expected a run"):
        read_frames(run)
    (run / RECORD).write_text(json.dumps({"method": "v3", "done": [asdict(frame) for frame in FRAMES]}))
    assert read_frames(run) == FRAMES
    assert main([str(run), "--traces", "const:8", "--offsets", "1", "--fps", "10"]) == 0
    assert "v3" in capsys.readouterr().out
    assert main([str(run), "--traces", "none.csv"]) == 2
