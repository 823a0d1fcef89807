"""The experiment on devices: all of it on the CPU, and its comparison with a stand-in for gsplat."""

from dataclasses import replace

import pytest

from airgs_codec.render import backend
from tests.faces import ConfigError, EncodeSettings, LevelSettings
from tests.support.training import write_blobs
from tools.lab import main, seconds_of
from tools.lab.bench import devices
from tools.lab.bench.devices import Fit, Options, fit, fitted, measured
from tools.lab.command import Lab
from tools.lab.timing import Alone

QUICK = EncodeSettings(calibrate="none", measure_pictures=0, preset="ultrafast", levels=(LevelSettings(0.0),))
TENTH = "a tenth of a fit"


def here(function, *arguments, limit_s):
    """What `alone` does, in this process."""
    took, value = seconds_of(lambda: function(*arguments))
    return Alone(took, 1.0), value


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    return write_blobs(tmp_path_factory.mktemp("scene") / "blobs")


@pytest.fixture(scope="module")
def model(scene, tmp_path_factory):
    folder = tmp_path_factory.mktemp("models") / "m"
    rows, gpu = measured(fit, "cpu", Fit(scene, "cuda", 0.01), folder)
    assert gpu is None and rows == fitted("cpu", Fit(scene, "cuda", 0.01), folder)
    return folder


def test_all_parts_are_done_and_the_page_is_kept_after_each(scene, model, tmp_path, monkeypatch):
    monkeypatch.setattr(devices, "alone", here)
    monkeypatch.setattr(devices, "EncodeSettings", lambda: QUICK)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))  # is set again where it encodes
    kept = []
    lab = replace(Lab.at(tmp_path / "lab", quiet=True), keep=kept.append)
    options = Options((scene,), sequence=model, device="cpu", effort=0.01, cameras=1)
    page = devices.run(options, lab)
    machine, fits, encodes, seen, parts = (list(table.rows) for table in page.sections[0].tables)
    assert [row["state"] for row in parts] == ["done"] * 8 and len(kept) == 8 and not page.failed
    assert [row["part"] for row in parts] == [
        "compare", "fit", "compare", "encode", "a tenth of a fit", "a tenth of a fit", "encode", "fit",
    ]  # fmt: skip
    assert [row["iterations"] for row in fits] == ["25, 10, 3", "2, 1, 1", "2, 1, 1", "25, 10, 3"]
    times = ("first frame, s", "keyframe, s", "frame in a group, s", "PSNR, dB", "held-out, dB", "Gaussians")
    assert all(row[name] > 0 for row in fits for name in times) and fits[0]["pictures"] == "40 x 40"
    assert fits[0]["PSNR, dB"] == fits[3]["PSNR, dB"] > fits[1]["PSNR, dB"]
    assert encodes[0]["bytes a frame"] == encodes[1]["bytes a frame"] > 100 and encodes[0]["frames"] == 5
    assert [(row["scene"], row.get("SH")) for row in seen] == [
        *(("m", degree) for degree in (0, 1, 3)), *(("blobs", degree) for degree in (0, 1, 3)),
        ("largest", None), ("limit", None),
    ]  # fmt: skip
    assert next(row["is"] for row in machine if row["machine"] == "torch")


def test_without_a_gpu_it_is_one_line_and_2(scene, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(backend, "_missing", lambda: "torch sees no CUDA device")
    assert main(["devices", str(scene), "-o", str(tmp_path)]) == 2
    assert capsys.readouterr().err == "lab devices: device cuda: torch sees no CUDA device\n"
    with pytest.raises(ConfigError, match="--limit and an --effort above 0, got 0 and 1"):
        Options((scene,), limit=0)
