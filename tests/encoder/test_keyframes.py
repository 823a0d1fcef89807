"""Keyframes that are what differs from an earlier group: a room that stands still is coded once."""

from dataclasses import replace

import numpy as np
import pytest

from tests import faces
from tests.faces import MEASURING, decode, decode_canonical, mse, open_package, psnr, render, validate
from tests.support.packages import GROUP, KEPT_KEYFRAMES, PACKAGES
from tests.support.scenes import MOVER, room_behind_a_door

CELLS = 256  # samples of a macroblock


@pytest.fixture(scope="module")
def package(package_of):
    return open_package(package_of("keyframes"))


def keyframe_bytes(m, group):
    """Bytes of all keyframe files of a group, whose number counts from 1."""
    files = {f for t in range(m.tiers) for q in range(2) for f in m.keyframe_files(group - 1, t, q)}
    return m.bytes_of(sorted(files))


def unchanged(one, other):
    """(N,) rows of a group that are those of its base bit by bit."""
    names = ("means", "quaternions", "log_scales", "opacity", "colour")
    return np.all([(getattr(one, n) == getattr(other, n)).reshape(len(one.means), -1).all(1) for n in names], axis=0)


def test_such_a_package_is_valid_keeps_its_promises_and_costs_only_what_differs(package):
    m = package.manifest
    assert [group.base for group in m.groups] == [None, None, 2, 2, None, 5, 5, 5, None, 9, None, 11]
    assert "7 of 12 keyframes are coded as what differs from an earlier one" in m.decisions
    assert validate(package.files.path) == []
    assert faces.exceeded(faces.measure_errors(package, PACKAGES["keyframes"].scene())) == []
    assert all(keyframe_bytes(m, group) < 0.75 * keyframe_bytes(m, 2) for group in (3, 4))
    assert [t.count for t in m.groups[8].tiers] == [t.count for t in m.groups[9].tiers]
    assert m.groups[9].count == 5000 + round(MOVER * 5000)
    assert keyframe_bytes(m, 10) <= 0.15 * keyframe_bytes(m, 9)


def test_what_stands_still_is_that_of_the_base_and_a_viewer_with_fewer_tiers_has_the_first_rows(package):
    """Joining at the second group shows it as in the first; beside what moves H.264 changes samples a little."""
    tiers, blocks, first = package.manifest.groups[9].tiers, [], 0
    for tier in tiers:
        blocks += [range(i, min(i + CELLS, first + tier.count)) for i in range(first, first + tier.count, CELLS)]
        first += tier.count
    for quality in (0, 1):
        one, other = (decode_canonical(package, group, quality) for group in (8, 9))
        same, still = unchanged(one, other), np.abs(one.means).max(axis=1) > 0.8  # walls are at 1, the mover within 0.5
        alone = [same[block].all() for block in blocks if still[block].all()]
        assert all(alone) and len(alone) >= len(blocks) / 3 and same.sum() >= 0.85 * 5000
    few = next(faces.decode_frames(package, 9 * GROUP, 9 * GROUP + 1, tiers=1)).gaussians.means
    np.testing.assert_array_equal(few, decode(package, 9 * GROUP).means[: tiers[0].count])


def test_a_base_that_cannot_be_one_is_refused(package):
    first, second = package.manifest.groups[4:6]
    for wrong in (
        {"base": 1}, {"tiers": [replace(t, count=1) for t in first.tiers]}, {"colour_transform": ""},
        {"tiers": [replace(t, factor=2 * t.factor) for t in first.tiers]}, {"grid": replace(first.grid, finest=9)},
        {"keyframe_steps": replace(first.keyframe_steps, opacity=1.0)},
    ):  # fmt: skip
        groups = faces.Groups.of([*package.manifest.groups[:4], replace(first, **wrong), second])
        with pytest.raises(faces.FormatError, match="group/6") as caught:
            decode_canonical(faces.Package(package.files, replace(package.manifest, groups=groups), 0), 5, 0)
        assert caught.value.reason == "bad_value"


def test_what_changed_by_less_than_the_codec_errs_differs_by_nothing_and_has_no_pictures(package):
    assert unchanged(*(decode_canonical(package, group, 0) for group in (4, 5))).sum() == 380
    first, last = (decode(package, group * GROUP).sh_dc[:, 0] / KEPT_KEYFRAMES.steps.keyframe.sh_dc for group in (4, 6))
    moved = np.abs(last - first)  # in one picture with rows that change much the others are no longer exact
    drawn = int((PACKAGES["keyframes"].groups()[4][0].opacities()[:100] >= 1 / 255).sum())
    assert [(moved < 3).sum(), (moved > 25).sum()] == [380 - drawn, drawn]
    assert [len(package.manifest.keyframe_files(7, t, 0)) for t in range(2)] == [1, 1]
    one, other = (np.sort(decode(package, group * GROUP).means, axis=0) for group in (4, 7))
    np.testing.assert_array_equal(one, other)


def test_what_a_door_hides_in_the_base_is_fine_enough_where_it_is_seen(package):
    """Nobody sees the room in the first group. With positions as coarse as do there, it has 34 dB."""
    shown, original = decode(package, 11 * GROUP), room_behind_a_door(1500, True)
    views = faces.draw_views(package.manifest.region, 6, MEASURING)
    assert psnr(np.mean([mse(render(shown, view).rgb, render(original, view).rgb) for view in views])) > 44


def test_a_base_that_knew_of_no_open_door_is_none():
    """Where groups come one by one, the second is coded by itself if the first had no word of it."""
    sequence = faces.GaussianSequence.from_arrays([room_behind_a_door(1500, is_open) for is_open in (False, True)])
    plan = faces.decide(sequence, replace(KEPT_KEYFRAMES, group_frames=1))
    for run, base in ((plan.run, 1), (0, None)):
        first, second = replace(plan, run=run).frames(sequence)
        assert faces.encode_group(second, plan, faces.encode_group(first, plan)[1])[0].table.base == base


def test_the_first_keyframe_of_a_run_has_rows_that_any_of_its_groups_needs(package, package_of):
    """The mover of a room is not there at first, nor is what a shut door hides."""
    away, there, shut, open_, alone = open_package(package_of("rows")).manifest.groups
    assert there.base == 1 and away.count == there.count > alone.count
    assert open_.base == 3 and open_.count == shut.count
    sequence, settings = PACKAGES["rows"].scene(), PACKAGES["rows"].settings
    plan = faces.decide(sequence, settings)
    assert faces.encode_group(replace(plan, run=0).frames(sequence)[2], plan)[0].table.count < shut.count
    assert all(group.unused > 0 for group in (away, there, shut, open_))
    noted = [entry for group in (away, there) for entry in group.left_out if entry.what == "gaussians"]
    assert [(entry.count, entry.error > 0, entry.bytes > 0) for entry in noted] == [(1050 - away.count, True, True)] * 2
    kept = package.manifest.groups  # there all is kept
    assert all(group.unused == 0 for group in kept)
    assert {entry.what for group in kept for entry in group.left_out} <= {"updates"}
