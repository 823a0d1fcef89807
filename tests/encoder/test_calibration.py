"""Steps, ladder and targets of a scene, and what it does without."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from airgs_codec._sampling import evenly_spaced
from airgs_codec.analysis.grouping import plan_groups
from airgs_codec.analysis.importance import RowPruning, estimate_cost, select_omissions
from airgs_codec.analysis.sensitivity import MAX_VIEWS, measure_sensitivity
from airgs_codec.cli import encode as command
from airgs_codec.coding.steps import StepSettings
from airgs_codec.decoder.decode import decode_canonical, decode_frames, decode_segment
from airgs_codec.encoder.calibration import cache
from airgs_codec.encoder.calibration.calibrate import calibrate
from airgs_codec.encoder.calibration.solve import STEPS, get_step, solve_steps, with_step
from airgs_codec.encoder.calibration.subject import Subject
from airgs_codec.encoder.levels import assign_depths
from airgs_codec.encoder.publish import encode
from airgs_codec.encoder.rate_target import PSNR, SIZE, Goal, find_quality
from airgs_codec.encoder.settings import EncodeSettings
from airgs_codec.encoder.survey import GroupSpan, ViewSplit, survey_group
from airgs_codec.errors import ConfigError
from airgs_codec.inspect.validate import validate
from airgs_codec.media.metrics import mse
from airgs_codec.package.store import open_package
from airgs_codec.package.tables import STATIC, pooled_quality
from airgs_codec.render import render
from airgs_codec.scene.ply import write_ply
from airgs_codec.scene.sequence import USAGE_NAME, open_sequence
from airgs_codec.scene.usage import Usage, save_usage
from tests.support.paths import FOX
from tests.support.scenes import moving_frames, random_gaussians, write_demo, write_sequence

FAST = EncodeSettings(preset="veryfast", jobs=2)


@pytest.fixture(scope="module")
def fox():
    sequence = open_sequence(FOX)
    views = ViewSplit.of(sequence)
    span = GroupSpan(0, *plan_groups(sequence).spans[0])
    return sequence, survey_group(sequence, span, views.training), views


@pytest.fixture(scope="module")
def calibration(fox):
    return calibrate(*fox, FAST)


def test_a_calibration_is_the_same_every_time_and_survives_the_cache(fox, calibration):
    assert calibrate(*fox, FAST) == calibration
    name = cache.digest(*fox, FAST)
    cache.keep(name, calibration)
    assert cache.load(name) == calibration
    assert cache.digest(*fox, replace(FAST, quality=2.0)) == name  # quality multiplies what was calibrated
    assert cache.digest(*fox, replace(FAST, segment_s=0.5)) != name
    (cache.folder() / f"{name}.json").write_text('{"steps": 3}')
    assert cache.load(name) is None


def test_a_calibration_is_found_anew_when_anything_that_it_reads_changes(tmp_path):
    frames = moving_frames(30, 6)
    folder = write_sequence(tmp_path / "scene", frames)

    def digest():
        sequence = open_sequence(folder)
        views, span = ViewSplit.of(sequence), GroupSpan(0, 0, 6)
        return cache.digest(sequence, survey_group(sequence, span, views.training), views, FAST)

    digests = [digest()]
    for number in (1, 2, 4):  # neither first, canonical nor last
        write_ply(sorted(folder.glob("*.ply"))[number], random_gaussians(30, seed=number))
        digests.append(digest())
    usage = Usage(np.ones(30), np.ones(30), np.ones(30, np.int64), np.ones(30))
    for moved in (usage.moved, 2 * usage.moved):
        save_usage(folder / USAGE_NAME, {(0, 6): replace(usage, moved=moved)})
        digests.append(digest())
    assert len(set(digests)) == len(digests)
    assert digest() == digests[-1]


def test_steps_are_named_once_and_replaced_one_at_a_time():
    steps = StepSettings()
    for name in [*STEPS, "rows"]:
        changed = with_step(steps, name, 7.0)
        assert get_step(changed, name) == 7.0
        assert [n for n in [*STEPS, "rows"] if get_step(changed, n) != get_step(steps, n)] == [name]


def test_a_step_far_from_its_price_comes_back(fox):
    """Means four times too fine or too coarse: calibration moves them the other way."""
    sequence, survey, views = fox
    wanted = {}
    for factor in (0.25, 1.0, 4.0):
        start = StepSettings()
        start = with_step(start, "state.means", factor * get_step(start, "state.means"))
        subject = Subject.of(sequence, survey, views, replace(FAST, steps=start))
        steps, price = solve_steps(subject.sample(24.0), subject)
        assert price > 0
        others = [get_step(steps, n) / get_step(start, n) for n in ("state.quaternions", "state.log_scales")]
        wanted[factor] = get_step(steps, "state.means") / get_step(start, "state.means") / float(np.mean(others))
    assert wanted[0.25] > 1.3 * wanted[1.0] > 1.3**2 * wanted[4.0]


def test_ladders_descend(calibration):
    shares, factors = zip(*calibration.levels, strict=True)
    assert list(shares) == sorted(shares) and list(factors) == sorted(factors) and factors[0] == 1
    assert len(set(calibration.levels)) == len(calibration.levels) > 1
    assert calibration.key_factors[0] == 1 < calibration.key_factors[1]
    assert sum(calibration.tiers) == pytest.approx(1)
    settings = calibration.apply(FAST)
    assert (settings.levels, settings.steps) == (calibration.levels, calibration.steps)
    assert calibration.apply(replace(FAST, calibrate="steps")).levels == FAST.levels


def test_a_scene_that_stands_still_has_one_level(tmp_path):
    sequence = open_sequence(write_sequence(tmp_path, [random_gaussians(300)]))
    views = ViewSplit.of(sequence)
    found = calibrate(sequence, survey_group(sequence, GroupSpan(0, 0, 1), views.training), views, FAST)
    assert found.levels == ((0.0, 1.0),) and found.core_levels == 0
    assert found.steps.state == StepSettings().state


def test_removed_rows_cost_what_was_allowed(fox):
    sequence, survey, views = fox
    loaded = sequence.load(range(survey.span.start, survey.span.stop)).frames
    frames = [loaded[i] for i in survey.span.surveyed]
    pruning = RowPruning(frames, views.training, survey.importance)
    counts = []
    for allowed in (0.0, 0.002, 0.005, 0.02):
        kept = pruning.within(allowed)
        assert kept.error <= allowed**2
        assert not kept.rows[survey.importance[kept.rows] == 0].size
        counts.append(len(kept.rows))
    assert counts == sorted(counts, reverse=True) and counts[0] > counts[-1]
    pictures = [mse(render(frames[1].take(kept.rows), c).rgb, render(frames[1], c).rgb) for c in views.training]
    assert float(np.mean(pictures)) < 3 * allowed**2  # of views that were not looked at


def test_the_error_of_leaving_one_row_out_is_known_without_rendering(fox):
    """A picture is linear in an alpha; what is left is the chance in the signs of `measure_sensitivity`."""
    sequence, survey, views = fox
    frame = sequence.load([survey.span.canonical]).frames[0]
    s = measure_sensitivity([frame], views.training)
    expected = s.opacity * frame.opacities().astype(np.float64) ** 2
    seen = np.argsort(-survey.usage.total)[:40]
    cameras = [views.training[i] for i in evenly_spaced(len(views.training), MAX_VIEWS)]
    full = [render(frame, c).rgb for c in cameras]
    rendered = []
    for row in seen:
        without = frame.take(np.delete(np.arange(len(frame)), row))
        rendered.append(
            np.mean([np.mean((render(without, c).rgb - a) ** 2) for c, a in zip(cameras, full, strict=True)])
        )
    assert expected[seen].sum() == pytest.approx(sum(rendered), rel=0.25)


def test_things_go_as_long_as_they_pay():
    sizes, errors = np.array([10.0, 10.0, 10.0]), np.array([1.0, 100.0, 3.0])

    def error(chosen):
        return float(errors[chosen].sum())

    assert select_omissions(sizes, errors, error, 0.0) == (pytest.approx(np.zeros(3)), 0.0)
    assert select_omissions(sizes, errors, error, 1.0)[0].tolist() == [True, False, True]
    # guesses that are too low: fewer are left out
    assert select_omissions(sizes, np.zeros(3), error, 1.0)[0].tolist() == [
        True,
        False,
        False,
    ]
    assert select_omissions(sizes, np.zeros(3), lambda chosen: 1e9, 1.0)[0].tolist() == [False] * 3


def test_guessed_bytes_are_the_entropy():
    values = np.zeros((2, 2, 8))
    values[:, 1] = [[-1, 1] * 4] * 2  # one bit a row in the first picture, nothing changes after it
    sizes, errors = estimate_cost(values, np.zeros(2), np.ones((2, 8)))
    assert sizes.tolist() == [0.0, 1.0]
    assert errors.tolist() == [0.0, pytest.approx(8 - 0.8)]


def test_a_search_ends_at_its_goal():
    tried = []

    def trial(factor):
        tried.append(factor)
        return 43.0 - 7.0 * math.log(factor) + 0.02 * math.sin(40 * factor)

    assert trial(find_quality(Goal(PSNR, 35.0), trial, 1.0)) == pytest.approx(35.0, abs=0.1)
    assert len(tried) <= 6
    size = find_quality(Goal(SIZE, 3.0), lambda f: 1.0 + 12.0 * f**-0.9, 1.0)
    assert 1.0 + 12.0 * size**-0.9 == pytest.approx(3.0, rel=0.01)
    with pytest.raises(ConfigError, match=r"0\.5 kB/frame is out of reach, the nearest was 1"):
        find_quality(Goal(SIZE, 0.5), lambda f: 1.0 + 12.0 * f**-0.9, 1.0)
    with pytest.raises(ConfigError, match="positive PSNR, got nan"):
        Goal(PSNR, math.nan)


@pytest.fixture(scope="module")
def first_frames(tmp_path_factory):
    """The first three frames of the embedded scene, one group, seen in small pictures."""
    return write_demo(tmp_path_factory.mktemp("targets") / "fox", frames=3, scale=0.5)


def run(scene, tmp_path, capsys, *options):
    arguments = [str(scene), "-o", str(tmp_path / "out"), "--preset", "veryfast", *options]
    code = command.main([*arguments, "--json"])
    captured = capsys.readouterr()
    return code, json.loads(captured.out) if code == 0 else captured.err


def test_targets_are_reached(first_frames, tmp_path, capsys):
    code, report = run(first_frames, tmp_path, capsys, "--target-psnr", "41")
    assert code == 0 and validate(tmp_path / "out") == []
    m = open_package(tmp_path / "out").manifest
    assert pooled_quality(m, 0, 0).psnr == pytest.approx(41, abs=0.3)
    wanted = 0.8 * report["top_rung_bytes"] / m.frames / 1e6
    code, report = run(first_frames, tmp_path, capsys, "--target-mb", f"{wanted}")
    assert code == 0 and report["top_rung_bytes"] / m.frames / 1e6 == pytest.approx(wanted, rel=0.03)
    assert report["calibration_cached"]
    code, report = run(first_frames, tmp_path, capsys, "--target-mbps", f"{1.4 * 8 * wanted * float(m.fps)}")
    assert code == 0 and report["top_rung_bytes"] / m.frames / 1e6 == pytest.approx(1.4 * wanted, rel=0.03)


def test_a_target_out_of_reach_is_one_line_and_leaves_nothing(first_frames, tmp_path, capsys):
    code, error = run(first_frames, tmp_path, capsys, "--target-mb", "0.000001")
    assert code == 2 and error.count("\n") == 1 and "out of reach" in error
    assert list(tmp_path.iterdir()) == []


def test_keep_all_keeps_all(demo_package, tmp_path):
    settings = replace(FAST, keep_all=True, measure_frames=0, calibrate="none")
    everything, less = (
        encode(open_sequence(FOX), tmp_path / "all", settings).manifest,
        open_package(demo_package).manifest,
    )
    assert all(g.unused == 0 for g in everything.groups)
    assert {entry.what for entry in everything.left_out} <= {"updates"}
    assert all(g.unused > 0 for g in less.groups)
    noted = [entry for entry in less.left_out if entry.what == "gaussians"]
    assert [entry.count for entry in noted] == [g.unused for g in less.groups]
    assert all(entry.error > 0 and entry.bytes > 0 for entry in noted)


def test_bands_that_do_not_show_are_left_out(tmp_path):
    frames = moving_frames(400, 3, degree=3)
    rest = np.random.default_rng(0).normal(0, 0.5, frames[0].sh_rest.shape).astype(np.float32)
    rest[:, 3:] = 0
    sequence = open_sequence(write_sequence(tmp_path / "scene", [replace(g, sh_rest=rest) for g in frames]))
    encode(sequence, tmp_path / "out", FAST)
    package = open_package(tmp_path / "out")
    assert validate(tmp_path / "out") == []
    assert package.manifest.sh_degree == 1
    assert [(entry.what, entry.count) for entry in package.manifest.left_out[:1]] == [("sh bands", 2)]
    assert next(decode_frames(package, 0, 1)).gaussians.sh_rest.shape[1] == 3


def test_core_levels_do_with_the_first_tier(tmp_path):
    frames = moving_frames(600, 4)
    sequence = open_sequence(write_sequence(tmp_path / "scene", frames))
    settings = replace(FAST, calibrate="none", core_levels=2, tiers=(0.6, 0.4))
    encode(sequence, tmp_path / "out", settings)
    package = open_package(tmp_path / "out")
    m = package.manifest
    assert validate(tmp_path / "out") == []
    assert [level.tiers for level in m.levels] == [2, 2, 1, 1]
    assert not any(path.startswith("key/T1") for path in m.rung_files(0, 3))
    assert any(path.startswith("key/T1") for path in m.rung_files(0, 1))
    core = m.groups[0].tiers[0].count
    assert len(next(decode_frames(package, 0, 1, level=3)).gaussians) == core
    both = decode_canonical(package, 0, 0)
    assert (both.depths[core:][both.depths[core:] != STATIC] < 2).all()
    alone = list(decode_segment(package, 0, decode_canonical(package, 0, 0, 1), 3, 0, 4))
    beside = list(decode_segment(package, 0, both, 3, 0, 4))  # a viewer that has the second tier as well
    for a, b in zip(alone, beside, strict=True):
        np.testing.assert_array_equal(a.means, b.means[:core])
        np.testing.assert_array_equal(a.opacity_logits, b.opacity_logits[:core])


def test_depths_keep_to_tiers():
    score, moving = np.array([5.0, 4.0, 3.0, 2.0]), np.ones(4, bool)
    tiers = np.array([0, 1, 0, 1], np.uint8)
    assert assign_depths(score, moving, [0.0, 0.25, 0.5], tiers, [2, 2, 1]).tolist() == [2, 1, 1, 0]
    assert assign_depths(score, moving, [0.0, 0.25], tiers, [2, 1]).tolist() == [1, 0, 1, 0]
