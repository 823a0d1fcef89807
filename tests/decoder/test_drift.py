"""A thousand frames, any level at any segment, seeks and losses: always the bits of a fresh decode."""

import random
from dataclasses import replace

import numpy as np
import pytest

from airgs_codec.decoder.decode import decode_canonical, decode_segment
from airgs_codec.encoder.publish import encode
from airgs_codec.encoder.settings import EncodeSettings
from airgs_codec.inspect.errors import measure_errors
from airgs_codec.package.store import open_package
from airgs_codec.play.catalogue import Catalogue
from airgs_codec.play.link import Link
from airgs_codec.play.report.film import screen_frames
from airgs_codec.play.session import simulate
from airgs_codec.play.settings import SessionSettings
from airgs_codec.play.trace import open_trace
from airgs_codec.scene.sequence import open_sequence
from tests.support.manifests import missing
from tests.support.scenes import moving_frames, write_sequence


@pytest.fixture(scope="module")
def package(tmp_path_factory):
    """Forth and back, 1000 frames."""
    folder = tmp_path_factory.mktemp("drift")
    there = moving_frames(60, 40)
    turn = [*range(40), *range(38, 0, -1)]
    scene = write_sequence(folder / "scene", [there[turn[i % len(turn)]] for i in range(1000)])
    settings = EncodeSettings(calibrate="none", measure_frames=0, preset="ultrafast", keep_all=True, jobs=2)
    encode(open_sequence(scene), folder / "out", settings)
    return open_package(folder / "out"), open_sequence(scene)


def fresh(package, segment, quality, level):
    m = package.manifest
    base = decode_canonical(package, m.segments[segment].group, quality, m.levels[level].tiers)
    return list(decode_segment(package, segment, base, level, 0, m.segments[segment].stop - m.segments[segment].start))


def same(a, b):
    return all(np.array_equal(getattr(a, name), getattr(b, name)) for name in a.__slots__)


def test_errors_after_a_thousand_frames_are_those_of_the_first(package):
    measured = list(measure_errors(*package))
    assert all(e.error <= e.bound for e in measured)
    of = [np.array([e.error for e in measured if e.where == f"group {g} state L0"]) for g in range(34)]
    assert len(package[0].manifest.groups) == 34
    assert (np.mean(of[-10:], axis=0) < 1.5 * np.mean(of[:10], axis=0)).all()


def test_a_viewer_that_jumps_about_sees_what_a_new_one_would(package):
    package, _ = package
    m, chance = package.manifest, random.Random(1)
    bases, at = {}, 0
    for _ in range(60):
        at = chance.randrange(len(m.segments)) if chance.random() < 0.3 else (at + 1) % len(m.segments)
        if chance.random() < 0.1:  # lost
            continue
        level, quality = chance.randrange(len(m.levels)), chance.randrange(len(m.qualities))
        group = m.segments[at].group
        base = bases.setdefault((group, quality), decode_canonical(package, group, quality))
        stop = m.segments[at].stop - m.segments[at].start
        shown = list(decode_segment(package, at, base, level, 0, stop))
        tiers = m.levels[level].tiers
        if tiers == m.tier_count:
            assert all(same(a, b) for a, b in zip(shown, fresh(package, at, quality, level), strict=True))


def test_a_session_over_a_bad_link_shows_the_bits_of_fresh_decodes(package):
    package, _ = package
    m = package.manifest
    levels = [[replace(v, psnr=[45.0 - 2 * j, 38.0 - j]) for j, v in enumerate(s.levels)] for s in m.segments]
    segments = [replace(s, levels=row) for s, row in zip(m.segments, levels, strict=True)]
    c = Catalogue(replace(m, segments=segments), manifest_bytes=package.manifest_bytes)  # something to weigh
    lost = missing(*(f"state/L0/{n}.m4s" for n in range(3, 30, 5)), "key/T0/7.bin")
    link = Link(open_trace("markov:5:0.2"))
    log = simulate(c, link, "paper", SessionSettings(loops=1), lost)
    assert len({s.rung for s in log.shown}) > 3 and any(s.rung is None for s in log.shown)
    chance = random.Random(2)
    ticks = log.screen_ticks
    for (gaussians, entry), (_, frame) in zip(screen_frames(package, log), ticks, strict=True):
        s = log.shown[entry]
        if s.rung is not None and chance.random() < 0.05:
            assert same(gaussians, fresh(package, s.segment, *c.rungs[s.rung])[frame])
