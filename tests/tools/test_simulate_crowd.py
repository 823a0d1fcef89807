"""The tool that simulates crowds: what it writes, and what it refuses."""

import csv
import json
import shutil

import pytest

from tests.support.paths import FOX
from tools import simulate_crowd


@pytest.fixture
def traces(tmp_path):
    folder = tmp_path / "traces"
    folder.mkdir()
    shutil.copy(FOX / "trace.csv", folder / "one.csv")
    return folder


def test_a_crowd_is_simulated_and_written(demo_package, traces, tmp_path, capsys):
    out = tmp_path / "out"
    words = [str(demo_package), "--traces", str(traces), "-o", str(out), "--viewers", "12", "--join", "2"]
    words += ["--watch", "2", "--policy", "throughput", "throughput,bola", "--jobs", "1", "--price", "edge_gb=2"]
    assert simulate_crowd.main(words) == 0
    assert "Side by side behind one of 50 %" in capsys.readouterr().out
    with (out / "crowd.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [(row["policies"], row["bottleneck"], row["policy"]) for row in rows if row["bottleneck"] == "50 %"] == [
        ("throughput", "50 %", "throughput"),
        ("throughput, bola", "50 %", "throughput"),
        ("throughput, bola", "50 %", "bola"),
        ("throughput, bola", "50 %", "all"),
    ]
    record = json.loads((out / "crowd.json").read_text())
    assert record["machine"]["cores"] and record["prices"]["edge_gb"] == 2 and len(record["seconds"]) == 6
    text = (out / "crowd.md").read_text()
    for name in ("cache", "egress", "stalls", "policies"):
        assert f"(crowd-{name}.png)" in text and (out / f"crowd-{name}.png").stat().st_size > 5_000
    assert "| bytes to viewers | 2 a GB |" in text


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--policy", "nothing"], "nothing"),
        (["--policy", "oracle-lp"], "oracle-lp"),
        (["--viewers", "0"], "viewer"),
        (["--price", "nothing=1"], "expected one of edge_gb"),
        (["--price", "edge_gb=much"], "expected NAME=PRICE"),
        (["--traces", "/nowhere"], "expected a folder of traces"),
        (["--jobs", "0"], "--jobs"),
    ],
)
def test_what_cannot_be_is_one_line(demo_package, traces, tmp_path, words, message, capsys):
    out = tmp_path / "out"
    assert simulate_crowd.main([str(demo_package), "--traces", str(traces), "-o", str(out), *words]) == 2
    error = capsys.readouterr().err
    assert message in error and error.count("\n") == 1 and not out.exists()
