"""The judge of held-out cameras: what it calls matched, and what it calls fog."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from airgs_codec.errors import ConfigError
from airgs_codec.render import cpu, look_at
from airgs_codec.scene.gaussians import Gaussians, join_rows
from airgs_codec.trainer.data.pictures import Target, View
from tests.support.paths import FOX_VIEWS
from tools.lab.bench.splits import Options, compare, from_half_way, run, shown_to
from tools.lab.command import Lab


def _ball(place: tuple[float, float, float], radius: float, colour: float) -> Gaussians:
    return Gaussians(
        means=np.array([place], np.float32),
        quaternions=np.array([[1, 0, 0, 0]], np.float32),
        log_scales=np.full((1, 3), np.log(radius), np.float32),
        opacity_logits=np.array([6.0], np.float32),
        sh_dc=np.full((1, 3), (colour - 0.5) / 0.28209479, np.float32),
        sh_rest=np.zeros((1, 0, 3), np.float32),
    )


CAMERA = look_at(np.array([0.0, 0.0, -4.0]), np.zeros(3), np.array([0.0, 1.0, 0.0]), size=48, fov_y=0.9, name="camera")


def test_a_gain_and_an_offset_of_a_camera_are_matched_and_nothing_else() -> None:
    g = _ball((0, 0, 0), 0.6, 0.5)
    seen = cpu.render(g, CAMERA).rgb
    brighter = View(CAMERA, Target(1.2 * seen + np.float32(0.05)))
    plain, matched = compare([g, g], [brighter, brighter])
    assert plain < 30
    assert matched > 90
    moved = View(CAMERA, Target(np.roll(seen, 4, axis=1)))
    assert compare([g], [moved])[1] < 30


def test_a_camera_that_is_late_sees_the_model_when_its_picture_was_taken() -> None:
    frames = [_ball((x, 0, 0), 0.6, 0.5) for x in (0.0, 0.1, 0.4)]
    model = SimpleNamespace(read=frames.__getitem__, record=SimpleNamespace(group_start=lambda frame: 0))
    late = [View(CAMERA, Target(cpu.render(frames[0], CAMERA).rgb), after=after) for after in (0.0, 0.5, -0.5)]
    shown = [float(g.means[0, 0]) for g in shown_to(model, late)]  # type: ignore[arg-type]
    assert shown == pytest.approx([0.0, 0.1 + 0.05, 0.4 - 0.15])


def test_only_what_is_right_before_a_viewer_half_way_is_haze() -> None:
    far = _ball((0, 0, 0), 0.6, 0.5)
    clear, haze = from_half_way(far, CAMERA, np.zeros(3))
    assert haze == pytest.approx(0, abs=1e-6)
    assert clear.max() > 0.4
    before = join_rows([far, _ball((0, 0, -1.9), 0.1, 0.5)])  # the viewer stands at z = -2
    assert from_half_way(before, CAMERA, np.zeros(3))[1] > 0.5


def test_more_cameras_than_there_are_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="9 splits of 9 need more"):
        run(Options(FOX_VIEWS, splits=9, hold=9), Lab.at(tmp_path))
