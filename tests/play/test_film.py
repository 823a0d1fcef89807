"""What a viewer sees and hears: his walk, and sound, which a group has at every rung, or else is silent, not lost."""

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

from tests import faces
from tests.faces import NONE, FileEntry, Offers, Sound, airgs_play, open_package, sound_path, walk, walk_through
from tests.support.chirps import moment, read_samples
from tests.support.manifests import HASH, in_groups, link, missing, play, tiny_manifest
from tests.support.regions import arc, row

TINY = tiny_manifest()
GROUPS = in_groups([replace(group, sound=FileEntry(700, HASH)) for group in TINY.groups])
SOUNDING = replace(TINY, sound=Sound(2, 312, FileEntry(50, HASH)), groups=GROUPS)
STEP_S = 2.0  # of a walk, from a place to the next
FPS = Fraction(30_000, 1001)


def positions(walk):
    return np.array([camera.position for camera in walk])


@pytest.mark.parametrize(("some", "steps"), [
    (arc(315, 8, 1.2), 14), (arc(180, 2, 0.0), 2), (row(6, 0.7), 10),  # a ring, opposite places and a row
])  # fmt: skip
def test_a_walk_comes_by_all_places_without_a_jump_and_begins_again(some, steps):
    views = walk_through(some, np.linspace(0, STEP_S * steps, 2001))
    assert np.linalg.norm(np.diff(positions(views), axis=0), axis=1).max() < 0.03
    for place in some.places:
        assert np.linalg.norm(positions(views) - place.position, axis=1).min() < 0.01
    np.testing.assert_allclose(views[-1].world_to_camera, views[0].world_to_camera, atol=1e-9)


@pytest.mark.parametrize("degrees", [315, 180])
@pytest.mark.parametrize("count", [2, 7])
def test_nobody_walks_through_what_he_looks_at(degrees, count):
    views = walk_through(arc(degrees, count, 0.1), np.linspace(0, 2 * STEP_S * count, 500))
    np.testing.assert_allclose(np.linalg.norm(positions(views), axis=1), 3, atol=1e-9)
    towards = np.array([camera.world_to_camera[2, :3] for camera in views])
    np.testing.assert_allclose(towards, -positions(views) / 3, atol=1e-9)


@pytest.mark.parametrize("reach", [0.0, 1.0])
def test_about_one_place_he_goes_in_a_circle_of_half_its_reach(reach):
    some = row(1, reach)
    views = walk_through(some, np.linspace(0, 8 * STEP_S, 100))
    away = np.linalg.norm(positions(views) - some.places[0].position, axis=1)
    assert away.max() == pytest.approx(0.5 * reach) and away.min() >= 0.4 * reach


@pytest.mark.parametrize(("size", "shown"), [((32, 24), (32, 24)), ((1500, 3000), (320, 640))])
def test_a_session_has_a_picture_for_every_tick_and_they_have_a_bound(size, shown):
    m = replace(TINY, region=replace(row(1, 1.0), width=size[0], height=size[1]))
    log = play(m, link([9e6]), loops=2)
    views = walk(log)
    assert len(views) == len(log.screen_ticks) == 40 and {(v.width, v.height) for v in views} == {shown}


def test_every_rung_has_its_sound_first_and_until_it_is_there():
    offer = Offers(SOUNDING, 0).offer(1)
    for rung in range(len(offer.rungs)):
        assert offer.missing(rung, NONE).keyframes[0] == sound_path(2)
        keyframes = frozenset(of.keyframe for of in offer.rungs[rung].keyframes)
        in_keyframes = offer.bytes_after(offer, NONE)[0, rung] - offer.rungs[rung].delta_bytes
        assert offer.sizes(NONE)[rung] - offer.sizes(keyframes)[rung] == in_keyframes
    assert SOUNDING.rung_files(1, 2)[:2] == [sound_path(1), sound_path(2)]


@pytest.mark.parametrize("policy", ["fixed:0", "robust-mpc", "paper-no-cliff"])
def test_its_bytes_count_and_a_stall_waits_for_it(policy):
    silent, log = (play(m, link([5e4]), policy, loops=2) for m in (TINY, SOUNDING))
    assert log.metrics.bytes["sound"] == 4 * 700 and "sound" not in silent.metrics.bytes  # each group in each loop
    if policy == "fixed:0":
        late = [s.ready_s - t.ready_s for s, t in zip(log.shown, silent.shown, strict=True)]
        assert late == pytest.approx([8 * 700 * n / 5e4 for n in (1, 2, 3, 4)])
        assert log.metrics.stall_s == pytest.approx(silent.metrics.stall_s + 3 * 8 * 700 / 5e4)


def test_a_group_without_its_sound_is_shown():
    log = play(SOUNDING, link([8e6]), "paper-no-cliff", faults=missing(sound_path(1)), loops=2)
    assert [s.rung for s in log.shown] == [0, 0, 0, 0] and log.metrics.lost_frames == 0
    assert log.metrics.bytes["sound"] == 2 * 700
    assert any(sound_path(1) in line for line in log.lost)


def heard(samples, second):
    return moment(samples[round(48_000 * second) - 1024 : round(48_000 * second) + 1024])


def test_what_is_heard_goes_with_the_ticks_of_a_session_and_stalls_are_silent(package_of):
    """The link gives out for a while, and the sequence is played twice."""
    package = open_package(package_of("sound"))
    rules = faces.SessionSettings(loops=2, buffer_s=0.5)
    log = faces.simulate(package, faces.Trace.open("const:0.3"), "fixed:0", rules)
    ticks, samples = log.screen_ticks, faces.sound_of(package, log)
    assert log.metrics.stall_s > 0.2 and samples.shape == (round(len(ticks) / FPS * 48_000), 1)
    numbers = [package.manifest.segments[log.shown[entry].segment].start + frame for entry, frame in ticks]
    steps = np.diff(numbers)
    silent = played = 0
    for tick in range(3, len(ticks) - 3):
        part = samples[round(tick / FPS * 48_000) : round((tick + 1) / FPS * 48_000), 0].astype(float)
        if (steps[tick - 3 : tick + 3] == 0).all():
            silent += 1
            assert np.abs(part).max() == 0
        elif (steps[tick - 3 : tick + 3] == 1).all():
            played += 1
            now, expected = (tick + 0.5) / FPS, (numbers[tick] + 0.5) / FPS
            assert heard(samples[:, 0].astype(float), now) == pytest.approx(expected, abs=0.003)
    assert silent > 3 and played > 40


def test_films_have_the_sound(package_of, tmp_path):
    seen, package = tmp_path / "seen.mp4", str(package_of("sound"))
    options = ["--trace", "const:9", "--policy", "fixed:0", "--player.loops", "1", "--video", str(seen)]
    assert airgs_play([package, *options]) == 0
    for second in (0.2, 0.6, 1.1):
        assert heard(read_samples(seen), second) == pytest.approx(second, abs=0.003)
