"""The tool that simulates crowds: what it writes, and what it refuses."""

import csv
import json
import shutil
from pathlib import Path

import pytest

from airgs_codec.errors import ConfigError
from tests.support.paths import FOX
from tools.lab import main
from tools.lab.command import Lab
from tools.lab.crowd.experiment import Options, run


@pytest.fixture
def traces(tmp_path):
    folder = tmp_path / "traces"
    folder.mkdir()
    shutil.copy(FOX / "trace.csv", folder / "one.csv")
    return folder


def test_a_crowd_is_simulated_and_written(demo_package, traces, tmp_path, capsys):
    out = tmp_path / "out"
    words = ["crowd", str(demo_package), str(traces), "-o", str(out), "--viewers", "12", "--join", "2", "--watch", "2"]
    words += ["--policies", "throughput", "throughput,bola", "--jobs", "1", "--prices.edge-gb", "2"]
    assert main(words) == 0
    assert "Side by side behind one of 50 %" in " ".join(capsys.readouterr().out.split())
    with (out / "crowd.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [(row["policies"], row["bottleneck"], row["policy"]) for row in rows if row["bottleneck"] == "50 %"] == [
        ("throughput", "50 %", "throughput"),
        ("throughput, bola", "50 %", "throughput"),
        ("throughput, bola", "50 %", "bola"),
        ("throughput, bola", "50 %", "all"),
    ]
    record = json.loads((out / "crowd.json").read_text())
    assert "cores" in record["machine"] and record["prices"]["edge_gb"] == 2 and len(record["seconds_of_crowds"]) == 6
    text = (out / "crowd.md").read_text()
    for name in ("cache", "egress", "stalls", "policies"):
        assert f"(crowd-{name}.png)" in text and (out / f"crowd-{name}.png").stat().st_size > 5_000
    assert "| bytes to viewers | 2 a GB |" in text


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"policies": ("nothing",)}, "nothing"),
        ({"policies": ("oracle-lp",)}, "oracle-lp"),
        ({"viewers": 0}, "viewer"),
        ({"traces": Path("/nowhere")}, "expected a folder of traces"),
        ({"jobs": 0}, "--jobs"),
    ],
)
def test_what_cannot_be_is_refused(demo_package, traces, tmp_path, change, message):
    options = Options(**{"package": demo_package, "traces": traces} | change)
    with pytest.raises(ConfigError, match=message) as refused:
        run(options, Lab.at(tmp_path))
    assert "\n" not in str(refused.value)
