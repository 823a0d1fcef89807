"""Callers take figures and events of sessions as plain values, make traces, and compare, draw and write frames."""

import json

import numpy as np
import pytest

import airgs_codec as airgs
from tests.faces import read_picture, to_bytes
from tests.support.paths import FOX, GOLDEN
from tests.support.regions import is_inside

PACKAGE = GOLDEN / "fox"


def test_figures_and_events_are_plain_values_and_a_data_frame():
    log = airgs.simulate(PACKAGE, "const:5", "bola")
    figures, events = json.loads(json.dumps([log.metrics.as_dict(), log.events]))
    assert figures["psnr_mean"] == log.metrics.psnr_mean
    kinds, times = ([event[key] for event in events] for key in ("event", "at_s"))
    assert kinds.count("fetch") == len(log.fetches) and times == sorted(times)
    assert [event["at_s"] for event in events if event["event"] == "show"] == [part.start_s for part in log.shown]
    frame = log.to_pandas()
    assert list(frame["event"]) == kinds and frame.attrs == log.metrics.as_dict()
    assert frame["bytes"].sum() == sum(fetch.bytes for fetch in log.fetches)


def test_a_trace_is_made_of_arrays():
    trace = airgs.Trace.from_arrays([10, 11, 13], np.array([8.0, 0, 4]))
    assert [trace.rate_at(at) for at in (0.5, 1.5, 3.5)] == [8e6, 0, 4e6] and trace.duration_s == 5
    assert airgs.simulate(PACKAGE, trace, "bola").link.trace is trace


def test_a_policy_knows_the_throughput():
    seen = []

    def largest(state):
        seen.append(state.throughput_bps)
        return airgs.Decision(state.options[0].index, True, "the largest", state.options[0].size_bytes)

    airgs.simulate(PACKAGE, "const:5", largest, airgs.SessionSettings(loops=4))
    assert 0 < seen[-1] <= 5e6 * (1 + 1e-9)


def test_what_is_open_is_compared_and_what_is_at_a_path():
    cameras, frames = [airgs.Camera.look_at((0, -1, -4), (0, 0, 0), size=(64, 48))], range(0, 4, 2)
    package = airgs.open_package(PACKAGE)
    top = airgs.Sequence.from_arrays([f.gaussians for f in airgs.decode_frames(package, 0, 4)], fps=24)
    same, low = (airgs.compare(top, package, rung=r, cameras=cameras, frames=frames) for r in (None, "Q1+L1"))
    assert same.frames == (0, 2) and same.quality.psnr > low.quality.psnr > 20
    assert airgs.compare(str(PACKAGE), PACKAGE, rung="Q1+L1", frames=frames).quality.psnr < 60


def test_a_frame_is_written_and_read_in_formats_by_their_names(tmp_path):
    frame = airgs.read(str(FOX / "000000.ply"))
    assert airgs.write(frame, tmp_path / "frame.ply") == []
    assert (airgs.read(tmp_path / "frame.ply").means == frame.means).all()
    assert any("SH" in line for line in airgs.write(frame, str(tmp_path / "frame.splat")))
    assert len(airgs.read(tmp_path / "frame.splat")) == len(frame)


def test_a_frame_is_a_png_in_four_lines_and_cameras_are_inside_the_region(tmp_path):
    package = airgs.open_package(PACKAGE)
    picture = airgs.draw(airgs.decode(package, 0), package.cameras[0])
    picture.save(tmp_path / "frame.png")
    assert (read_picture(tmp_path / "frame.png") == to_bytes(picture.rgb)).all() and picture.rgb.std() > 0.05
    region = package.manifest.region
    assert len(package.cameras) == len(region.places) and all(is_inside(region, view) for view in package.cameras)


NO_TRACES = (([], []), ([0, 1], [5]), ([[0]], [[5]]), ([1, 0], [5, 5]), ([0], [-1]), (["a"], [1]), (0, 5))
FRAME, CAMERA = airgs.read(FOX / "000000.ply"), airgs.Camera.look_at((0, 0, -3), (0, 0, 0), size=(16, 16))
BOTH = "expected an open sequence or package, or the path of one"


@pytest.mark.parametrize(("call", "arguments", "settings", "line"), [
    *((airgs.Trace.from_arrays, arrays, {}, "arrays: ") for arrays in NO_TRACES),
    (airgs.compare, (3, PACKAGE), {}, f"reference: {BOTH}, got int 3"),
    (airgs.compare, (PACKAGE, PACKAGE), {"frames": range(0, 99)}, "frames: expected some of"),
    (airgs.compare, (PACKAGE, PACKAGE), {"frames": 3}, "frames: expected a range, got int 3"),
    (airgs.compare, (FOX, FOX), {"rung": "Q0+L0"}, "expected a package for the rung"),
    (airgs.read, (FOX,), {}, "expected one frame, got"),
    (airgs.read, (3,), {}, "path: expected a path or an address, got int 3"),
    (airgs.write, (FOX, "x.ply"), {}, "gaussians: expected Gaussians or a mapping of their arrays, got"),
    (airgs.write, (FRAME, None), {}, "path: expected a path or an address, got None"),
    (airgs.draw, (FRAME, "front"), {}, "camera: expected a Camera, got str 'front'"),
    (airgs.draw, (FOX, CAMERA), {}, "gaussians: expected Gaussians or a mapping"),
    *((airgs.draw(FRAME, CAMERA).save, (name,), {}, name) for name in ("frame.jpg", "none/frame.png")),
])  # fmt: skip
def test_what_cannot_be_is_refused_and_writes_nothing(call, arguments, settings, line, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(airgs.AirgsError, match=line):
        call(*arguments, **settings)
    assert list(tmp_path.iterdir()) == []
