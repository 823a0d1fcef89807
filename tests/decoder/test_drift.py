"""Hundreds of frames, any level over any keyframe tiers, seeks and lost files: the bits of a fresh decode."""

import random
import shutil
from collections import Counter
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest

from airgs_codec.play.film import screen_frames
from tests import faces
from tests.faces import FormatError, decode_canonical, decode_segment, measure_errors, open_package
from tests.support.digests import decode_keyframe
from tests.support.manifests import missing, with_segments
from tests.support.packages import PACKAGES


@pytest.fixture(scope="module")
def package(package_of):
    return open_package(package_of("drift"))


def fresh(package, segment, quality, level):
    m = package.manifest
    base, span = decode_canonical(package, m.group_of(segment), quality, m.levels[level].tiers), m.segments[segment]
    return list(decode_segment(package, segment, base, level, range(span.stop - span.start)))


def same(a, b):
    return all(np.array_equal(getattr(a, name), getattr(b, name)) for name in a.__slots__)


def test_errors_of_the_last_groups_are_those_of_the_first(package):
    measured = list(measure_errors(package, PACKAGES["drift"].scene()))
    assert all(e.error <= e.bound for e in measured)
    of = [np.array([e.error for e in measured if e.where == f"group {g} delta L0"]) for g in range(10)]
    assert len(package.manifest.groups) == 10
    assert (np.mean(of[-4:], axis=0) < 1.5 * np.mean(of[:4], axis=0)).all()


@contextmanager
def may_be_missing():
    try:
        yield
    except FormatError as error:
        assert error.reason == "missing_file"


def show(package, tiers, index, quality, level):
    """Frames of a segment, or None where a file is missing without which nothing can be shown.

    `tiers`: how many of the keyframe tiers of (group, quality) a viewer has decoded, from the first on.
    """
    m = package.manifest
    segment, group = m.segments[index], m.group_of(index)
    with may_be_missing():
        for tier in range(tiers[group, quality], m.levels[level].tiers):
            decode_keyframe(package, group, tier, quality)
            tiers[group, quality] += 1
    with may_be_missing():
        if have := tiers[group, quality]:
            base = decode_canonical(package, group, quality, have)
            return list(decode_segment(package, index, base, level, range(segment.stop - segment.start)))


def expected(package, index, quality, level, have):
    """What FORMAT.md section 5 promises a viewer of a whole package that has so many keyframe tiers."""
    m = package.manifest
    group = m.group_of(index)
    moving = sum(tier.count for tier in m.groups[group].tiers[: min(have, m.levels[level].tiers)])
    still = decode_canonical(package, group, quality, have).to_gaussians()
    for frame in fresh(package, index, quality, level):
        rows = [np.concatenate([getattr(frame, n)[:moving], getattr(still, n)[moving:]]) for n in frame.__slots__]
        yield faces.Gaussians(*rows)


def test_a_viewer_that_jumps_about_and_loses_files_sees_what_a_new_one_would(package, tmp_path):
    """Levels that need one tier and two over keyframes of one tier and two, and segments after files that never came.

    Of deltas every level lacks some, of second tiers some are missing, and of first tiers one.
    """
    m, chance = package.manifest, random.Random(3)
    deltas = [m.delta_files(i, j)[0] for i in range(len(m.segments)) for j in range(len(m.levels))]
    lost = {path for path in deltas if chance.random() < 0.1} | {m.keyframe_files(5, 0, 0)[0]}
    lost |= {m.keyframe_files(g, 1, q)[0] for g in range(0, len(m.groups), 4) for q in range(len(m.qualities))}
    shutil.copytree(package.files.path, tmp_path / "damaged")
    for path in lost:
        (tmp_path / "damaged" / path).unlink()
    assert {level.tiers for level in m.levels} == {1, 2}
    damaged, tiers, at, met, chance = open_package(tmp_path / "damaged"), Counter(), 0, Counter(), random.Random(1)
    for _ in range(80):
        at = chance.randrange(len(m.segments)) if chance.random() < 0.3 else (at + 1) % len(m.segments)
        level, quality = chance.randrange(len(m.levels)), chance.randrange(len(m.qualities))
        shown = show(damaged, tiers, at, quality, level)
        if shown is None:
            met["lost"] += 1
            continue
        have, needed = tiers[m.group_of(at), quality], m.levels[level].tiers
        met["fewer tiers" if have < needed else "more tiers" if have > needed else "its tiers"] += 1
        assert all(same(a, b) for a, b in zip(shown, expected(package, at, quality, level, have), strict=True))
    assert min(met[name] for name in ("lost", "fewer tiers", "more tiers", "its tiers")) >= 3


def test_a_session_over_a_bad_link_shows_the_bits_of_fresh_decodes(package):
    m, segments, chance = package.manifest, [], random.Random(2)
    for s in m.segments:  # something to weigh
        levels = [replace(v, psnr=[45.0 - 2 * j, 38.0 - j], delta_e=[0.5, 0.5]) for j, v in enumerate(s.levels)]
        segments.append(replace(s, levels=levels))
    m = replace(with_segments(m, segments), views=replace(m.views, reference="original"))
    c = faces.Offers(m, root_bytes=package.root_bytes)
    lost = missing(*(f"delta/L0/{n}.m4s" for n in range(3, 30, 5)), "keyframe/T0/7.bin")
    link = faces.Link(faces.Trace.open("markov:1:0.02"))
    log = faces.simulate(c, link, "paper", faces.SessionSettings(loops=1), lost)
    assert len({s.rung for s in log.shown}) > 4 and any(s.rung is None for s in log.shown)
    for (gaussians, entry), (_, frame) in zip(screen_frames(package, log), log.screen_ticks, strict=True):
        s = log.shown[entry]
        if s.rung is not None and chance.random() < 0.05:
            assert same(gaussians, fresh(package, s.segment, *c.rungs[s.rung])[frame])
