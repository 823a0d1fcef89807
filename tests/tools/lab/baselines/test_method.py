"""What all baselines share: frames are kept as they come, a stopped run goes on, another run is refused."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import pytest

from airgs_codec.errors import ConfigError
from airgs_codec.package.package import open_package
from airgs_codec.scene.formats.ply import read_ply
from airgs_codec.trainer.data.pictures import Pictures
from airgs_codec.trainer.data.readers import open_scene
from tests.support.paths import VALID
from tests.support.scenes import random_gaussians
from tests.support.training import write_blobs
from tools.lab.baselines.airgs import fetched_bytes, key_bytes
from tools.lab.baselines.method import Footage, Shown, frame_path, mean_bytes, run_method


@dataclass
class Growing:
    """Frame t has t + 10 Gaussians and 100 t bytes; it stops before frame `until`, as if it were killed."""

    name: str = "growing"
    settings: dict[str, object] = field(default_factory=lambda: {"rate": 0.1, "most": math.inf})
    until: int = 99
    asked: list[int] = field(default_factory=list)

    def frames(self, footage, done, progress):
        self.asked.append(done)
        for t in range(done, footage.frames):
            if t == self.until:
                raise KeyboardInterrupt
            yield Shown("frame" if t else "key", random_gaussians(t + 10), 100 * t, 0.5)


@pytest.fixture
def footage(tmp_path):
    scene = open_scene(write_blobs(tmp_path / "blobs"), frames=(0, 3))
    return Footage(Pictures(scene), 3, scene.points, tmp_path / "run")


def test_a_stopped_run_goes_on_where_it_stopped(footage):
    method = Growing(until=2)
    with pytest.raises(KeyboardInterrupt):
        run_method(method, footage)
    assert [path.name for path in sorted(footage.folder.glob("*.ply"))] == ["000000.ply", "000001.ply"]
    method.until = 99
    frames = run_method(method, footage)
    assert method.asked == [0, 2]
    assert [(f.kind, f.gaussians, f.bytes) for f in frames] == [("key", 10, 0), ("frame", 11, 100), ("frame", 12, 200)]
    assert len(read_ply(frame_path(footage.folder, 2))) == 12
    assert mean_bytes(frames) == 100
    assert run_method(method, footage) == frames
    assert method.asked == [0, 2]


def test_a_folder_of_another_run_is_refused(footage):
    run_method(Growing(), footage)
    with pytest.raises(ConfigError, match="these settings"):
        run_method(Growing(settings={"rate": 0.2}), footage)


def test_a_folder_of_other_pictures_is_refused(footage):
    run_method(Growing(), replace(footage, source={"size": 160}))
    with pytest.raises(ConfigError, match="these settings"):
        run_method(Growing(), replace(footage, source={"size": 320}))


def test_a_run_that_was_stopped_before_its_first_frame_is_not_another_one(footage):
    with pytest.raises(KeyboardInterrupt):
        run_method(Growing(until=0), footage)
    with pytest.raises(ConfigError, match="these settings"):
        run_method(Growing(settings={"rate": 0.2}), footage)


@pytest.mark.parametrize("name", ["kept", "moving", "one-gaussian", "paged", "two-groups-sh1"])
def test_bytes_of_frames_are_all_that_a_viewer_of_the_top_rung_fetches(name):
    package = open_package(VALID / name)
    m = package.manifest
    tables = [path for path in sorted((VALID / name).rglob("*")) if path.name in ("airgs.json", "manifest.mpd")]
    listed = {*m.rung_files(0, 0), *m.table_files(), "init.mp4"}
    sizes = fetched_bytes(package)
    assert len(sizes) == m.frames
    assert sum(sizes) == sum(p.stat().st_size for p in [*tables, *(VALID / name / path for path in listed)])
    assert all(sizes[group.start] >= key_bytes(m, number, 0) for number, group in enumerate(m.groups))
