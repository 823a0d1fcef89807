"""What all baselines share: frames are kept as they come, a stopped run goes on, another run is refused."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import pytest

from airgs_codec.errors import ConfigError
from airgs_codec.scene.ply import read_ply
from airgs_codec.train.data.pictures import Pictures
from airgs_codec.train.data.readers import open_scene
from tests.support.scenes import random_gaussians
from tests.support.training import write_blobs
from tools.baselines.method import Footage, Shown, frame_path, mean_bytes, run_method


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
