"""Keys that are what differs from an earlier group: a room that stands still is coded once."""

from dataclasses import replace

import numpy as np
import pytest

from airgs_codec.coding.atlas import CELLS
from airgs_codec.encoder.pipeline import DIFFERENCE, KEY, STEPS
from tests.faces import (
    APART,
    MEASURING,
    EncodeSettings,
    FormatError,
    Groups,
    GroupSpan,
    LevelSettings,
    Package,
    decode,
    decode_canonical,
    decode_frames,
    draw_views,
    encode,
    exceeded,
    measure_errors,
    mse,
    open_package,
    open_sequence,
    plan_views,
    psnr,
    render,
    survey_group,
    validate,
)
from tests.support.regions import region
from tests.support.rooms import MOVER, room_behind_a_door, room_frames
from tests.support.scenes import random_gaussians, write_sequence

ROWS, GROUP = 5000, 3
SETTINGS = EncodeSettings(
    calibrate="none",
    levels=(LevelSettings(0.0), LevelSettings(0.5, 2.0, tiers=1, quality=1)),
    decide_pictures=4,
    measure_pictures=0,
    region=region(),
    keep_all=True,
)


def encoded(folder, frames, settings=SETTINGS):
    """A package of frames, a group for every GROUP of them, and its sequence."""
    starts = list(range(0, len(frames), GROUP))
    sequence = open_sequence(write_sequence(folder / "frames", frames, fps=GROUP, keyframes=starts))
    encode(sequence, folder / "package", settings)
    return open_package(folder / "package"), sequence


def key_bytes(m, group):
    """Bytes of all key files of a group."""
    return m.bytes_of(sorted({f for t in range(m.tiers) for q in range(2) for f in m.key_files(group, t, q)}))


@pytest.fixture(scope="module")
def room(tmp_path_factory):
    return encoded(tmp_path_factory.mktemp("room"), room_frames(ROWS, 2 * GROUP))


def test_the_second_key_of_a_room_costs_only_its_mover(room):
    m = room[0].manifest
    first, second = m.groups
    assert (first.keeps, second.keeps) == (None, 1)
    assert [t.count for t in first.tiers] == [t.count for t in second.tiers]
    assert second.count == ROWS + round(MOVER * ROWS)
    assert key_bytes(m, 1) <= 0.15 * key_bytes(m, 0)


def test_such_a_package_is_valid_and_keeps_its_promises(room):
    package, sequence = room
    assert validate(package.files.path) == []
    assert exceeded(measure_errors(package, sequence)) == []


@pytest.mark.parametrize("quality", [0, 1])
def test_what_stands_still_is_that_of_the_base(room, quality):
    """Joining at the second group shows it as in the first; beside what moves H.264 changes samples a little."""
    package, _ = room
    one, other = joined(package, 0, 1, quality)
    same, still = unchanged(one, other), np.abs(one.means).max(axis=1) > 0.8  # walls are at 1, the mover within 0.5
    blocks, first = [], 0
    for tier in package.manifest.groups[1].tiers:
        blocks += [range(i, min(i + CELLS, first + tier.count)) for i in range(first, first + tier.count, CELLS)]
        first += tier.count
    alone = [same[block].all() for block in blocks if still[block].all()]
    assert all(alone) and len(alone) >= len(blocks) / 3 and same.sum() >= 0.85 * ROWS


def joined(package, base, group, quality=0):
    """The canonical spaces of a group and of its base."""
    return [decode_canonical(package, g, quality) for g in (base, group)]


def unchanged(one, other):
    """(N,) rows of a group that are those of its base bit by bit."""
    names = ("means", "quaternions", "log_scales", "opacity", "colours")
    columns = [getattr(one, name) == getattr(other, name) for name in names]
    return np.all([column.reshape(len(column), -1).all(axis=1) for column in columns], axis=0)


def test_a_viewer_with_fewer_tiers_has_the_first_rows(room):
    package, _ = room
    few = next(decode_frames(package, GROUP, GROUP + 1, tiers=1)).gaussians
    all_ = decode(package, GROUP)
    np.testing.assert_array_equal(few.means, all_.means[: package.manifest.groups[1].tiers[0].count])


def test_a_base_that_cannot_be_one_is_refused(room):
    package, _ = room
    first, second = package.manifest.groups

    def opened(*groups):
        return Package(package.files, replace(package.manifest, groups=Groups.of(groups)), 0)

    wrong = [replace(first, keeps=1), replace(first, tiers=[replace(t, count=1) for t in first.tiers])]
    wrong += [replace(first, tiers=[replace(t, factor=2 * t.factor) for t in first.tiers])]
    wrong += [replace(first, grid=replace(first.grid, finest=9)), replace(first, colour_transform="")]
    for base in [*wrong, replace(first, key_steps=replace(first.key_steps, opacity=1.0))]:
        with pytest.raises(FormatError, match="group/2") as caught:
            decode_canonical(opened(base, second), 1, 0)
        assert caught.value.reason == "bad_value"


def test_a_group_is_coded_by_itself_when_that_is_asked_for(tmp_path):
    package, _ = encoded(tmp_path, room_frames(300, 2 * GROUP), replace(SETTINGS, keys=APART))
    assert [g.keeps for g in package.manifest.groups] == [None, None]
    assert not any("differs" in line for line in package.manifest.decisions)


def test_what_changed_is_coded_anew_and_is_the_next_base(tmp_path):
    """Another room in the second group; the fourth has the same as the third, of which a part has changed."""
    one, other = random_gaussians(400, seed=1), random_gaussians(400, seed=2)
    coloured = replace(other, sh_dc=np.concatenate([other.sh_dc[:100] + 1, other.sh_dc[100:]]))
    frames = [one] * GROUP + [other] * GROUP + [coloured] * GROUP + [coloured] * GROUP
    package, sequence = encoded(tmp_path, frames)
    m = package.manifest
    assert [g.keeps for g in m.groups] == [None, None, 2, 2]
    assert all(key_bytes(m, group) < 0.75 * key_bytes(m, 1) for group in (2, 3))
    assert "2 of 4 groups are coded as what differs from an earlier one" in m.decisions
    assert exceeded(measure_errors(package, sequence)) == []


def test_what_changed_by_less_than_the_codec_errs_differs_by_nothing(tmp_path):
    """Colours change by a twentieth of a step, and then those of a quarter of the rows by thirty."""
    one, step = random_gaussians(400), SETTINGS.steps.key.sh_dc
    change = np.zeros((400, 3), np.float32)
    change[:, 0] = 0.05 * step
    slight = replace(one, sh_dc=one.sh_dc + change)
    change[:100, 0] = 30 * step
    much = replace(one, sh_dc=one.sh_dc + change)
    package, sequence = encoded(tmp_path, [one] * GROUP + [slight] * GROUP + [much] * GROUP)
    assert [group.keeps for group in package.manifest.groups] == [None, 1, 1]
    assert unchanged(*joined(package, 0, 1)).sum() == 400
    first, last = (decode(package, group * GROUP).sh_dc[:, 0] / step for group in (0, 2))
    moved = np.abs(last - first)  # in one picture with rows that change much the others are no longer exact
    drawn = int((one.opacities()[:100] >= 1 / 255).sum())
    assert [(moved < 3).sum(), (moved > 25).sum()] == [400 - drawn, drawn]
    assert exceeded(measure_errors(package, sequence)) == []


def test_a_group_that_differs_by_nothing_has_no_pictures(tmp_path):
    package, _ = encoded(tmp_path, [random_gaussians(200)] * (2 * GROUP))
    m = package.manifest
    assert [len(m.key_files(1, t, 0)) for t in range(2)] == [1, 1]
    assert validate(package.files.path) == []
    np.testing.assert_array_equal(
        np.sort(decode(package, 0).means, axis=0), np.sort(decode(package, GROUP).means, axis=0)
    )


def test_what_a_door_hides_in_the_base_is_fine_enough_where_it_is_seen(tmp_path):
    """Nobody sees the room in the first group. With positions as coarse as do there, it has 34 dB."""
    shut, open_ = (room_behind_a_door(1500, is_open) for is_open in (False, True))
    package, _ = encoded(tmp_path, [shut] * GROUP + [open_] * GROUP)
    second, shown = package.manifest.groups[1], decode(package, GROUP)
    assert second.keeps == 1
    views = draw_views(package.manifest.region, 6, MEASURING)
    assert psnr(np.mean([mse(render(shown, view).rgb, render(open_, view).rgb) for view in views])) > 44


def test_a_base_that_knew_of_no_open_door_is_none(tmp_path):
    """The second group is coded by itself, where the first had no word of it."""
    frames = [room_behind_a_door(1500, is_open) for is_open in (False, True)]
    sequence = open_sequence(write_sequence(tmp_path / "frames", frames, keyframes=[0, 1]))
    views = plan_views(sequence, SETTINGS)
    known = {"sequence": sequence, "views": views, "settings": SETTINGS, "row_error": SETTINGS.row_error}
    for number in range(2):
        known["survey"] = survey_group(sequence, GroupSpan(number, number, number + 1), views)
        STEPS["written"].do(known)
        known.setdefault("base", KEY.do(known))
    assert DIFFERENCE.do(known) is None


def test_the_base_has_rows_that_later_groups_need_if_these_are_few(tmp_path):
    """The mover of a room is not there at first."""
    first, second = room_frames(1000, 1)[0], room_frames(1000, 3)[2]
    hidden = first.opacity_logits.copy()
    hidden[1000:] = -12
    frames = [replace(first, opacity_logits=hidden)] * GROUP + [second] * GROUP
    package, _ = encoded(tmp_path, frames, replace(SETTINGS, keep_all=False))
    one, other = package.manifest.groups
    alone, _ = encoded(tmp_path / "alone", frames[:GROUP], replace(SETTINGS, keep_all=False))
    assert other.keeps == 1 and one.count == other.count > alone.manifest.groups[0].count


def test_groups_that_need_many_more_rows_are_coded_by_themselves(tmp_path):
    shut, open_ = (room_behind_a_door(1500, is_open) for is_open in (False, True))
    package, _ = encoded(tmp_path, [shut] * GROUP + [open_] * GROUP, replace(SETTINGS, keep_all=False))
    one, other = package.manifest.groups
    assert other.keeps is None and one.count < other.count
