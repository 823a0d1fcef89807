"""What is compared and from where: scenes and rungs as sides, their bytes and rates, views that both are seen from."""

import numpy as np
import pytest

from airgs_codec.inspect.sides import DRAWS, comparable, compared_views, region_views, shared_views
from airgs_codec.package.region import CHECKING
from tests.faces import ConfigError, decode_frames, draw_views, left_out, open_package, open_side, summarise
from tests.support.multiview_files import write_cameras
from tests.support.paths import VALID
from tests.support.regions import arc
from tests.support.scenes import moving_frames, write_sequence
from tests.support.views import ring

PACKAGE = VALID / "moving"


def scene(folder, frames, **settings):
    return open_side(str(write_sequence(folder, frames, cameras=False, **settings)))


@pytest.fixture
def original(tmp_path):
    return scene(tmp_path / "original", moving_frames(40, 4))


def test_a_rung_has_its_bytes_its_claim_and_its_gaussians():
    package = open_package(PACKAGE)
    rungs = {f"{r.key}+{r.state}": r for r in summarise(package.manifest, package.manifest_bytes).rungs}
    for name in ("Q0+L0", "Q1+L1"):
        side = open_side(str(PACKAGE), name)
        assert side.rung == name and side.bytes_per_frame == rungs[name].bytes_per_frame
        assert side.claimed.psnr == rungs[name].psnr
        decoded = decode_frames(package, 2, 3, key_quality=name[:2], level=name[3:])
        assert np.array_equal(next(side.read(range(2, 3))).means, next(decoded).gaussians.means, equal_nan=True)
    assert open_side(str(PACKAGE)).rung == "Q0+L0" and open_side(str(PACKAGE)).label == "moving Q0+L0"
    for rung in ("Q9+L0", "Q0+L9", "Q0", "L0", ""):
        with pytest.raises(ConfigError, match="expected one of"):
            open_side(str(PACKAGE), rung or "+")


def test_a_scene_has_the_bytes_of_its_files_and_no_rungs(original, tmp_path):
    sizes = [path.stat().st_size for path in (tmp_path / "original").glob("*.ply")]
    assert original.bytes_per_frame == np.mean(sizes) and original.claimed is None and original.label == "original"
    with pytest.raises(ConfigError, match="expected a package for the rung Q0"):
        open_side(original.name, "Q0+L0")


def test_frames_that_one_side_lacks_are_named(original, tmp_path):
    long, one_more = (scene(tmp_path / f"{n}", moving_frames(40, n)) for n in (6, 5))
    assert left_out(original, long) == left_out(long, original)
    assert left_out(original, long) == [f"frames 4 to 5 of {long.name}, which {original.name} does not have"]
    assert left_out(original, one_more)[0].startswith("frame 4 of") and left_out(original, original) == []


def test_rates_that_are_stated_must_agree(tmp_path):
    frames = moving_frames(10, 2)
    slow, fast = (scene(tmp_path / f"at{fps}", frames, fps=fps) for fps in (24, 30))
    with pytest.raises(ConfigError, match=r"at30: expected 24 frames a second as .*at24, got 30"):
        comparable(slow, fast)
    comparable(slow, scene(tmp_path / "silent", frames))
    comparable(slow, scene(tmp_path / "single", frames[:1], fps=30))


def test_views_are_those_of_the_scenes_or_of_the_region_or_an_orbit(original, tmp_path):
    package = open_side(str(PACKAGE))
    words, views = shared_views(original, package)
    assert f"{DRAWS} views drawn from the viewing region of {PACKAGE}, seed 2" == words
    drawn = draw_views(package.region, DRAWS, CHECKING)
    assert all(np.array_equal(a.world_to_camera, b.world_to_camera) for a, b in zip(views, drawn, strict=True))
    words, views = shared_views(original, original)
    assert "orbit around frame 0" in words and len(views) == 8
    write_cameras(tmp_path / "original" / "transforms.json", ring(4, held_out=1))
    words, views = shared_views(package, open_side(original.name))
    assert words == f"1 held-out camera of {original.name}" and [v.split for v in views] == ["test"]


def test_held_out_cameras_are_taken_where_there_are_any():
    assert [c.split for c in compared_views(ring(4, held_out=1), None)] == ["test"]
    assert len(compared_views(ring(4), None)) == 4
    drawn = region_views(arc(90, 3, 1.0), 5, 2)
    assert [c.split for c in compared_views([*ring(4, held_out=1), *drawn], None)] == ["test"] + ["region"] * 5
    assert len(compared_views([*ring(4), *drawn], None)) == 9
    assert len(compared_views(ring(4, held_out=1), "train")) == 3
    with pytest.raises(ConfigError, match="split: expected one of train"):
        compared_views(ring(4), "test")
