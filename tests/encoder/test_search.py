"""A goal is found in few trials, or what holds pictures back most is named."""

import json
import math
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

from airgs_codec.cli import encode as command
from airgs_codec.coding.channels import fit_colour_transform, from_klt, to_klt
from airgs_codec.encoder.batch import calibrate_sequence, encode_sequence, measure_encoded
from airgs_codec.encoder.search import SIZE, find_quality, search_quality, weigh_colours
from airgs_codec.render import cpu
from tests.faces import (
    DELTA_E,
    PSNR,
    ConfigError,
    EncodeSettings,
    Goal,
    Picture,
    ViewPlan,
    decode,
    draw_views,
    open_package,
    open_sequence,
    pack_matrix,
    pooled_quality,
    temporary_work,
    unpack_matrix,
    validate,
)
from tests.support.jobs import prepared_as_one_group
from tests.support.regions import place, region
from tests.support.scenes import moving_frames, write_demo, write_sequence


def test_a_search_ends_at_its_goal():
    tried = []

    def trial(factor):
        tried.append(factor)
        return 43.0 - 7.0 * math.log(factor) + 0.02 * math.sin(40 * factor)

    assert trial(find_quality(Goal(PSNR, 35.0), trial, 1.0)) == pytest.approx(35.0, abs=0.1)
    assert len(tried) <= 6
    size = find_quality(Goal(SIZE, 3.0), lambda f: 1.0 + 12.0 * f**-0.9, 1.0)
    assert 1.0 + 12.0 * size**-0.9 == pytest.approx(3.0, rel=0.01)
    colour = find_quality(Goal(DELTA_E, 0.8), lambda f: round(0.1 + 0.3 * f**0.7, 2), 1.0)
    assert 0.1 + 0.3 * colour**0.7 == pytest.approx(0.8, rel=0.03)
    with pytest.raises(ConfigError, match=r"0\.1 ΔE is out of reach, the nearest was 0\.203 at quality factor 0\.01"):
        find_quality(Goal(DELTA_E, 0.1), lambda f: 0.2 + 0.3 * f, 1.0)
    with pytest.raises(ConfigError, match=r"0\.5 kB/frame is out of reach, the nearest was 1"):
        find_quality(Goal(SIZE, 0.5), lambda f: 1.0 + 12.0 * f**-0.9, 1.0)
    for metric, value, words in (
        (PSNR, math.nan, "positive PSNR, got nan"),
        (DELTA_E, 0.0, "positive ΔE, got 0"),
        (DELTA_E, 0.001, "at least 0.01 ΔE, to which it is rounded, got 0.001"),
        (DELTA_E, 101.0, "at most 100 ΔE, that of black and white, got 101"),
    ):
        with pytest.raises(ConfigError, match=words):
            Goal(metric, value)


def test_a_colour_difference_ten_times_as_large_as_asked_for_is_none():
    assert find_quality(Goal(DELTA_E, 0.01), lambda _: 0.02, 1.0) == 1.0  # what tables round
    with pytest.raises(ConfigError, match=r"0\.01 ΔE is out of reach, the nearest was 0\.1 at"):
        find_quality(Goal(DELTA_E, 0.01), lambda _: 0.1, 1.0)


def test_a_goal_between_two_trials_is_in_reach_however_they_jump():
    tried = {}

    def trial(factor):
        tried[factor] = 42.0 - 7.0 * math.log(factor) + (1.0 if factor < 1.5 else -1.0)
        return tried[factor]

    found = find_quality(Goal(PSNR, 39.1), trial, 1.0)
    assert abs(tried[found] - 39.1) == min(abs(got - 39.1) for got in tried.values()) > 0.3
    with pytest.raises(ConfigError, match="at most 100 dB, that of equal pictures, got 200"):
        Goal(PSNR, 200)


@pytest.fixture(scope="module")
def first_frames(tmp_path_factory):
    """A part of the embedded scene in three frames, one group, seen in small pictures."""
    return write_demo(tmp_path_factory.mktemp("targets") / "fox", frames=3, rows=4000, scale=0.5)


def run(scene, tmp_path, capsys, *options):
    arguments = [str(scene), "-o", str(tmp_path / "out"), "--x264-preset", "veryfast", *options]
    code = command.main([*arguments, "--json"])
    captured = capsys.readouterr()
    return code, json.loads(captured.out) if code == 0 else captured.err


def test_targets_are_reached(first_frames, tmp_path, capsys):
    code, report = run(first_frames, tmp_path, capsys, "--target-psnr", "41")
    assert code == 0 and validate(tmp_path / "out") == []
    m = open_package(tmp_path / "out").manifest
    assert pooled_quality(m, 0, 0).psnr == pytest.approx(41, abs=0.3)
    wanted = 0.8 * report["top_rung_bytes"] / m.frames / 1e3
    code, report = run(first_frames, tmp_path, capsys, "--target-kb", f"{wanted}")
    assert code == 0 and report["top_rung_bytes"] / m.frames / 1e3 == pytest.approx(wanted, rel=0.03)
    assert report["calibration_cached"]


def test_a_colour_target_holds_for_views_that_no_trial_saw(first_frames, tmp_path, capsys):
    code, _ = run(first_frames, tmp_path, capsys, "--target-de", "0.6")
    package, sequence = open_package(tmp_path / "out"), open_sequence(first_frames)
    m = package.manifest
    assert code == 0 and pooled_quality(m, 0, 0).delta_e == pytest.approx(0.6, rel=0.05)
    errors = []
    for number, camera in enumerate(draw_views(m.region, 12, seed=9)):
        frame = number % m.frames
        shown = (cpu.render(g, camera, m.region.background).rgb for g in (sequence.read(frame), decode(package, frame)))
        errors.append(Picture.delta_e(*map(Picture.of, shown)))
    assert sum(errors) / len(errors) == pytest.approx(0.6, rel=0.1)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--target-de", "0"), "target: expected a positive ΔE, got 0"),
        (("--target-de", "nan"), "target: expected a positive ΔE, got nan"),
        (("--target-de", "grey"), "argument --target-de: expected a number, got 'grey'"),
        (
            ("--target-de", "1", "--target-psnr", "40"),
            "expected one of these options, got --target-psnr and --target-de",
        ),
        (("--target-de", "1", "--target-kb", "40"), "expected one of these options, got --target-de and --target-kb"),
    ],
)
def test_a_colour_target_that_cannot_be_is_one_line(first_frames, tmp_path, capsys, options, words):
    code, error = run(first_frames, tmp_path, capsys, *options)
    assert code == 2 and error.count("\n") == 1 and words in error
    assert list(tmp_path.iterdir()) == []


def test_sizes_are_told_by_the_frame_or_by_the_second(first_frames):
    sequence = open_sequence(first_frames, fps=Fraction(25))
    goals = [
        command._goal(command.Encode("x", **target), sequence)
        for target in ({"target_psnr": 41.0}, {"target_de": 0.5}, {"target_kb": 20.0}, {"target_mbps": 4.0}, {})
    ]
    assert goals == [Goal(PSNR, 41.0), Goal(DELTA_E, 0.5), Goal(SIZE, 20.0), Goal(SIZE, 20.0), None]  # kB a frame


def test_a_target_out_of_reach_is_one_line_and_leaves_nothing(first_frames, tmp_path, capsys):
    code, error = run(first_frames, tmp_path, capsys, "--target-kb", "0.001")
    assert code == 2 and error.count("\n") == 1 and "out of reach" in error
    assert list(tmp_path.iterdir()) == []


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    sequence = open_sequence(write_sequence(tmp_path_factory.mktemp("limits") / "scene", moving_frames(200, 3)))
    views = ViewPlan.of(sequence, 6, region=replace(region(place(0.0)), width=96, height=72))
    with temporary_work() as work:
        yield prepared_as_one_group(sequence, views, work), work


def test_colours_are_weighed_by_what_is_seen(scene):
    """Errors of every channel of the colour transform, a step each, make the same ΔE; green is seen best."""
    prepared, _ = scene
    steps = weigh_colours(EncodeSettings(), prepared).steps
    weights = np.array(steps.colours).reshape(3, 3)
    np.testing.assert_allclose(weights, weights.T)
    assert np.diag(weights).argmax() == 1 and np.linalg.eigvalsh(weights).min() >= 1 - 1e-9
    grown = steps.key.sh_dc / EncodeSettings().steps.key.sh_dc
    assert np.linalg.det(weights) == pytest.approx(grown**3) and steps.state.sh_rest == pytest.approx(0.08 * grown)
    colours = np.random.default_rng(0).normal(size=(50, 12)) * np.arange(1, 13)
    stored = unpack_matrix(pack_matrix(fit_colour_transform(colours, steps.colours)), 12)
    seen = stored @ np.kron(np.eye(4), weights)  # what a step in each channel changes, as it is seen
    np.testing.assert_allclose(seen @ seen.T, np.eye(12), atol=1e-3)
    np.testing.assert_allclose(from_klt(to_klt(colours, stored), stored), colours, atol=1e-9)


def test_a_goal_is_met_by_the_pictures_that_measure_the_package(scene):
    prepared, work = scene
    settings = EncodeSettings(calibrate="none", preset="ultrafast", measure_pictures=12)
    chosen, trials = search_quality(calibrate_sequence(prepared, settings, work), prepared, Goal(PSNR, 38.0), work)
    found = measure_encoded(encode_sequence(prepared, chosen, work), prepared, 12).manifest
    assert pooled_quality(found, 0, 0).psnr == pytest.approx(38.0, abs=0.3)
    assert 1 < len(trials) <= 8 and chosen.levels == settings.levels
