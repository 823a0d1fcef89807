"""Predicted against rendered errors."""

from dataclasses import replace

import numpy as np
import pytest

from airgs_codec.analysis.sensitivity import measure_sensitivity, measure_views
from airgs_codec.coding.motion import channel_weights, motion_classes, motion_units, withheld_error
from airgs_codec.media.metrics import mse
from airgs_codec.package.tables import StateSteps
from airgs_codec.render import render
from airgs_codec.scene.gaussians import Gaussians, from_rotation_vector, multiply, sigmoid
from airgs_codec.scene.sequence import open_sequence
from tests.support.paths import FOX
from tests.support.views import measure_usage


@pytest.fixture(scope="module")
def scene():
    sequence = open_sequence(FOX)
    frame = sequence.load([4]).frames[0]
    cameras = list(sequence.cameras)[:4]
    return frame, cameras, measure_sensitivity([frame] * 8, cameras)


def jittered(g: Gaussians, name: str, size: float) -> Gaussians:
    rng = np.random.default_rng(7)
    if name == "quaternions":
        turn = from_rotation_vector(rng.normal(0, size, (len(g), 3)))
        return replace(g, quaternions=multiply(turn, g.quaternions.astype(np.float64)).astype(np.float32))
    if name == "opacity":
        alpha = np.clip(sigmoid(g.opacity_logits.astype(np.float64)) + rng.normal(0, size, len(g)), 1e-6, 1 - 1e-6)
        return replace(g, opacity_logits=np.log(alpha / (1 - alpha)).astype(np.float32))
    value = getattr(g, name)
    return replace(g, **{name: (value + rng.normal(0, size, value.shape)).astype(np.float32)})


@pytest.mark.parametrize(
    ("name", "size"),
    [("means", 3e-4), ("log_scales", 3e-2), *((n, 1e-2) for n in ("quaternions", "opacity", "sh_dc", "sh_rest"))],
)
def test_errors_of_the_size_of_a_step_make_the_error_that_was_predicted(scene, name, size):
    frame, cameras, s = scene
    worse = jittered(frame, name, size)
    rendered = np.mean([mse(render(worse, c).rgb, render(frame, c).rgb) for c in cameras])
    assert size**2 * getattr(s, name).sum() == pytest.approx(rendered, rel=0.2)


def test_the_cost_of_withholding_is_the_rendered_one(scene):
    frame, cameras, s = scene
    steps = StateSteps(means=1e-4, quaternions=0.01, log_scales=0.02, opacity=1e-3, sh_dc=0.01, sh_rest=0.01)
    classes = motion_classes(s.means, 1e-2 * float(np.median(s.means)))
    channels = 10 + 3 * (1 + frame.sh_rest.shape[1])
    moved = np.random.default_rng(0).normal(0, 1, (1, channels, len(frame)))
    weights = channel_weights(classes, s.by_attribute(), steps, np.eye(channels - 10))
    for start, stop, name in ((0, 3, "means"), (3, 6, "log_scales"), (10, channels, "sh_dc")):
        changes = np.zeros_like(moved)
        changes[:, start:stop] = moved[:, start:stop]
        unit = motion_units(classes)[:, None] if name == "means" else 1.0
        by = {name: getattr(steps, name) * unit * changes[0, start : min(stop, start + 3)].T}
        if name == "sh_dc":
            by["sh_rest"] = steps.sh_rest * changes[0, 13:].T.reshape(frame.sh_rest.shape)
        other = replace(frame, **{n: (getattr(frame, n) + value).astype(np.float32) for n, value in by.items()})
        rendered = np.mean([mse(render(other, c).rgb, render(frame, c).rgb) for c in cameras])
        assert withheld_error(changes, weights).sum() == pytest.approx(rendered, rel=0.3), name


def test_what_is_behind_the_scene_counts(scene):
    """A black row changes nothing before black, whatever its opacity; before white it does."""
    frame, cameras, _ = scene
    one = frame.take(np.argsort(frame.opacity_logits)[-1:])
    black = replace(one, sh_rest=0 * one.sh_rest, sh_dc=np.full((1, 3), -10, np.float32))
    white = [replace(view, background=(1.0, 1.0, 1.0)) for view in cameras]
    assert measure_sensitivity([black], cameras).opacity.max() == 0 < measure_sensitivity([black], white).opacity.max()


def test_views_and_frames_are_averaged(scene):
    frame, cameras, _ = scene
    once, twice = (measure_sensitivity(frames, cameras[:1]) for frames in ([frame], [frame, frame]))
    assert twice.sh_dc.sum() == pytest.approx(once.sh_dc.sum(), rel=0.1)
    assert replace(once).take(np.array([2, 0])).opacity.tolist() == [once.opacity[2], once.opacity[0]]


def test_every_picture_has_a_frame_and_a_camera_of_its_own(scene):
    """A row counts in the frames in which it is seen, by the camera that was paired with them."""
    frame, cameras, _ = scene
    away = replace(frame, means=frame.means + np.float32(1e5))
    seen, unseen = measure_usage([frame], cameras[:1]), measure_usage([frame], cameras[1:2])
    usage, s = measure_views([(frame, cameras[0]), (away, cameras[1])])
    np.testing.assert_array_equal(usage.hits, seen.hits)
    assert (usage.hits != unseen.hits).any()
    alone = measure_views([(frame, cameras[0])])[1]
    for name in s.__slots__:
        assert getattr(s, name).sum() == pytest.approx(getattr(alone, name).sum() / 2)
