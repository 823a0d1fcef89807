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
from tools.lab.crowd.page import Prices, cache_words, cost_words, link_words
from tools.lab.crowd.runs import Run


@pytest.fixture
def traces(tmp_path):
    folder = tmp_path / "traces"
    folder.mkdir()
    shutil.copy(FOX / "trace.csv", folder / "one.csv")
    return folder


def test_a_crowd_is_simulated_and_written(demo_package, traces, tmp_path, capsys):
    out = tmp_path / "out"
    words = ["crowd", str(demo_package), str(traces), "-o", str(out), "--viewers", "12", "--join", "2", "--watch", "2"]
    words += ["--policies", "throughput", "throughput,bola", "--jobs", "1", "--prices.gb", "2"]
    assert main(words) == 0
    assert "Behind a bottleneck of 50 % viewers see" in " ".join(capsys.readouterr().out.split())
    with (out / "crowd.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [(row["policies"], row["bottleneck"], row["policy"]) for row in rows if row["bottleneck"] == "50 %"] == [
        ("throughput", "50 %", "throughput"),
        ("throughput, bola", "50 %", "throughput"),
        ("throughput, bola", "50 %", "bola"),
        ("throughput, bola", "50 %", "all"),
    ]
    record = json.loads((out / "crowd.json").read_text())
    assert "cores" in record["machine"] and record["prices"] == {"gb": 2, "million": 0.75}
    shown = [(row["bottleneck"], row["crowd"], row["policy"]) for row in record["figures"]["crowd-viewers"]]
    assert shown == [
        *((bottleneck, "alone", "throughput") for bottleneck in ("none", "100 %", "50 %")),
        ("50 %", "mixed", "throughput"),
        ("50 %", "mixed", "bola"),
    ]
    assert "(crowd-cache.png)" in (out / "crowd.md").read_text() and (out / "crowd-cache.png").stat().st_size > 5_000


def crowd(bottleneck, **viewers):
    row = {"policy": "a", "psnr": 40.0, "stalled_share": 0.1, "mbps": 8.0, "requests_s": 10.0} | viewers
    edge = {"busy_viewers": 1000, "busy_edge_mbps": 2000, "busy_origin_mbps": 4, "byte_hit_rate": 0.998, "files_mb": 30}
    cache = [{"cache_mb": mb, "byte_hit_rate": rate} for mb, rate in ((1, 0.3), (32, 0.998), (64, 0.9985))]
    return Run(("a",), bottleneck, None, 2000.0, [row], edge, cache)


def test_a_cache_is_as_large_as_it_need_be():
    assert cache_words(crowd("none")).endswith(
        "it answers 99.80 % of the bytes, and one of 32 MB does as well, of 30 MB of files; one of 1 MB answers 30 %."
    )


def test_a_narrow_link_takes_away_or_does_not():
    less, more = ([crowd("none"), crowd("50 %", psnr=psnr, stalled_share=0.2)] for psnr in (38.0, 41.0))
    assert link_words(less) == "Behind a bottleneck of 50 % viewers see 2.0 dB less, and 20 % instead of 10 % stall."
    assert "1.0 dB more" in link_words(more) and link_words(less[:1]) == ""


@pytest.mark.parametrize(
    ("prices", "words"),
    [
        (Prices(0.02, 0.75), "cost 720 for bytes and 270 for requests: fewer bytes save more than longer groups."),
        (Prices(0.02, 7.5), "cost 720 for bytes and 2,700 for requests: longer groups save more than fewer bytes."),
    ],
)
def test_what_costs_more_is_to_be_spared(prices, words):
    assert cost_words(crowd("none"), prices).endswith(words)
    with pytest.raises(ConfigError, match="gb"):
        Prices(gb=-1)


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
    options = Options(**{"scene": str(demo_package), "traces": traces} | change)
    with pytest.raises(ConfigError, match=message) as refused:
        run(options, Lab.at(tmp_path))
    assert "\n" not in str(refused.value)
