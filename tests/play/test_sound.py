"""Sound in a session: fetched first and once a group at every rung; without it a group is silent, not lost.

Films of sessions have it.
"""

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

from airgs_codec.package.tables import FileEntry, Sound
from airgs_codec.play.film import sound_of
from tests.faces import NONE, Offers, SessionSettings, Trace, airgs_play, open_package, simulate, sound_path
from tests.play.test_session import link, play
from tests.support.chirps import moment, read_samples, write_chirping
from tests.support.manifests import HASH, in_groups, missing, tiny_manifest


def sounding(size=700, **options):
    m = tiny_manifest(**options)
    groups = [replace(group, sound=FileEntry(size, HASH)) for group in m.groups]
    return replace(m, sound=Sound(2, 312, FileEntry(50, HASH)), groups=in_groups(groups))


def test_every_rung_has_it_first_and_until_it_is_there():
    m = sounding()
    offer = Offers(m, 0).offer(1)
    for rung in range(len(offer.rungs)):
        assert offer.missing(rung, NONE).keys[0] == sound_path(2)
        keys = frozenset(of.key for of in offer.rungs[rung].keys)
        assert offer.sizes(NONE)[rung] - offer.sizes(keys)[rung] == offer.bytes_after(offer, NONE)[0, rung] - (
            offer.rungs[rung].state_bytes
        )
    assert m.rung_files(1, 2)[:2] == [sound_path(1), sound_path(2)]


@pytest.mark.parametrize("policy", ["fixed:0", "robust-mpc", "paper-no-cliff"])
def test_its_bytes_count_and_a_stall_waits_for_it(policy):
    silent = play(tiny_manifest(), link([5e4]), policy, loops=2)
    log = play(sounding(), link([5e4]), policy, loops=2)
    assert log.metrics.bytes["sound"] == 4 * 700 and "sound" not in silent.metrics.bytes  # each group in each loop
    if policy == "fixed:0":
        late = [s.ready_s - t.ready_s for s, t in zip(log.shown, silent.shown, strict=True)]
        assert late == pytest.approx([8 * 700 * n / 5e4 for n in (1, 2, 3, 4)])
        assert log.metrics.stall_s == pytest.approx(silent.metrics.stall_s + 3 * 8 * 700 / 5e4)


def test_a_group_without_its_sound_is_shown():
    log = play(sounding(), link([8e6]), "paper-no-cliff", faults=missing(sound_path(1)), loops=2)
    assert [s.rung for s in log.shown] == [0, 0, 0, 0] and log.metrics.lost_frames == 0
    assert log.metrics.bytes["sound"] == 2 * 700
    assert any(sound_path(1) in line for line in log.lost)


FPS = Fraction(30_000, 1001)


@pytest.fixture(scope="module")
def chirping(tmp_path_factory):
    return write_chirping(tmp_path_factory.mktemp("chirping"), 39, FPS, 13)


def heard(samples, second):
    """The moment of the chirp that is heard at a moment."""
    return moment(samples[round(48_000 * second) - 1024 : round(48_000 * second) + 1024])


def test_what_is_heard_goes_with_the_ticks_of_a_session_and_stalls_are_silent(chirping):
    """The link gives out for a while, and the sequence is played twice."""
    package = open_package(chirping)
    log = simulate(package, Trace.open("const:0.3"), "fixed:0", SessionSettings(loops=2, buffer_s=0.5))
    ticks, samples = log.screen_ticks, sound_of(package, log)
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
            assert heard(samples[:, 0].astype(float), (tick + 0.5) / FPS) == pytest.approx(
                (numbers[tick] + 0.5) / FPS, abs=0.003
            )
    assert silent > 3 and played > 40


def test_films_have_the_sound(chirping, tmp_path, capsys):
    seen = tmp_path / "seen.mp4"
    options = ["--trace", "const:9", "--policy", "fixed:0", "--player.loops", "1", "--video", str(seen)]
    assert airgs_play([str(chirping), *options]) == 0
    for second in (0.2, 0.6, 1.1):
        assert heard(read_samples(seen), second) == pytest.approx(second, abs=0.003)
