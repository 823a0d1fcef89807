"""Deltas: what is coded of them, where slopes pay, and pictures that every decoder leaves alone."""

from dataclasses import fields, replace
from fractions import Fraction
from functools import partial

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from airgs_codec.coding import atlas, channels, escapes, kernels
from airgs_codec.encoder import deltas, omit, sample, streams
from airgs_codec.media import h264, mp4
from tests import faces
from tests.faces import EncodeSettings, decode, decode_canonical, decode_frames, measure_errors, open_package
from tests.support.digests import decode_slopes
from tests.support.packages import PACKAGES, PLAIN, SEGMENT, TWO_LEVELS, laid_out
from tests.support.scenes import moving_frames, random_gaussians, write_sequence

CODEC, FPS = h264.delta_codec("veryfast"), Fraction(24)
LIMIT, UNIT = 96, 128  # of escapes: samples differ from 128 by at most LIMIT, and a base is UNIT codes
SETTINGS = EncodeSettings(calibrate="none", levels=TWO_LEVELS, segment_s=0.1, byte_price=1e-8, decide_pictures=2)


@pytest.fixture(scope="module")
def sequence(tmp_path_factory):
    """Six frames in which some rows come and go, some jump far and one is never drawn."""
    random, shown = np.random.default_rng(3), []
    for t, g in enumerate(moving_frames(700, 6, degree=1)):
        logits, means = g.opacity_logits.copy(), g.means.copy()
        logits[random.integers(0, 700, 60)] = -9.0
        logits[5] = -9.0
        means[7] += 100.0 * (t > 2)
        shown.append(replace(g, opacity_logits=logits, means=means))
    return faces.open_sequence(write_sequence(tmp_path_factory.mktemp("deltas") / "scene", shown))


@pytest.fixture(scope="module")
def group(sequence):
    """Its frames, how they are laid out, and the canonical space of two keyframe qualities."""
    layout = laid_out(sequence, SETTINGS)
    fine = layout.keyframe_values().astype(np.float32)
    still = np.full(len(layout.rows), faces.STATIC, np.uint8)
    return sequence.load(range(6)).frames, layout, [layout.canonical_space(k, still) for k in (fine, np.round(fine, 1))]


@pytest.fixture
def small_chunks(monkeypatch):
    monkeypatch.setattr(kernels, "CHUNK", 1)
    monkeypatch.setattr(kernels, "LEAST", 37)


def test_values_are_those_of_all_frames_together(group, tmp_path, small_chunks):
    frames, layout, (base, _) = group
    expected = channels.delta_channels([frame.take(layout.rows) for frame in frames], base, layout.delta_steps)
    values = omit.DeltaValues.write(tmp_path / "values", frames, layout.rows, base, layout.delta_steps)
    whole, some = values.part(slice(None)), np.arange(3, len(layout.rows), 5)
    np.testing.assert_allclose(whole, expected, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(values.channel(9, some), whole[:, 9, some])
    np.testing.assert_array_equal(values.frame(4), whole[4])
    np.testing.assert_array_equal(values.part(slice(10, 20), slice(2, 5)), whole[2:5, :, 10:20])
    assert sum(part.stop - part.start for part in values.chunks()) == len(layout.rows) > 37


def test_how_many_rows_are_looked_at_together_changes_nothing(sequence, group, tmp_path, small_chunks, monkeypatch):
    frames, layout, bases = group
    coded, clock, plan = [], streams.FrameClock.of(Fraction(30)), faces.decide(sequence, SETTINGS)
    for name in ("few", "many"):
        (tmp_path / name).mkdir()
        coded.append(deltas.code_deltas(layout, bases, frames, plan, clock, tmp_path / name))
        monkeypatch.undo()
    few, many = coded
    assert few.depths.tolist() == many.depths.tolist() and few.left_out == many.left_out
    assert any(level.escapes and any(level.escapes) for level in many.levels)
    for a, b in zip(few.levels, many.levels, strict=True):
        assert a.atlas == b.atlas and a.escapes == b.escapes
        assert a.samples is not None and b.samples is not None
        assert [x.tolist() for x in a.samples] == [x.tolist() for x in b.samples]
        assert [x.tolist() for x in a.samples.part(slice(2, 4))] == [x.tolist() for x in b.samples][2:4]


def test_frames_that_are_read_again_are_the_same(sequence, monkeypatch):
    kept = sequence.load(range(1, 6))
    monkeypatch.setattr("airgs_codec.scene.sequence.HELD_BYTES", 0)
    again = sequence.load(range(1, 6))
    assert isinstance(kept.frames, list) and not isinstance(again.frames, list)
    assert again.notes == kept.notes and len(again.frames) == 5
    assert again.frames[2] is again.frames[2]  # the last one is kept
    for a, b in zip(again.frames[1:4], kept.frames[1:4], strict=True):
        assert all(np.array_equal(getattr(a, f.name), getattr(b, f.name)) for f in fields(a))


VALUES = npst.arrays(np.float64, (6, 5), elements=st.sampled_from([0.0, 0.002, 0.005, 0.02, 0.3, 1.0]))


@given(VALUES, st.floats(0.001, 0.02))
def test_rows_that_are_not_drawn_are_hidden_by_bases_and_others_are_as_they_were(alpha, unit):
    base = np.array([0.0, 0.01, 0.3, 0.6, 1.0])
    changes, bases = deltas.hide_undrawn(alpha - base, base, unit)
    shown = base + changes - bases * UNIT * unit
    drawn, hidden = alpha >= 1 / 255, bases > 0
    np.testing.assert_allclose(shown[drawn], alpha[drawn], atol=1e-12)
    assert (bases[drawn] == 0).all()
    assert (shown[hidden] <= -(UNIT - LIMIT) * unit + 1e-9).all()  # whatever the video codec errs
    assert (np.abs(shown - alpha)[~drawn & ~hidden] <= 16 * unit + 1e-9).all()
    alpha = np.array([[0.8, 0.0, 0.8, 0.0, 0.0, 0.8]]).T  # samples of a row that goes and comes do not change
    changes, bases = deltas.hide_undrawn(alpha - 0.5, np.array([0.5]), 0.01)
    assert np.ptp(changes) == 0 and bases[:, 0].tolist() == [0, 1, 0, 1, 1, 0]


@pytest.fixture(scope="module")
def sloped(package_of):
    return open_package(package_of("slopes"))


def test_lines_of_segments_have_their_picture_in_front_and_segments_of_few_frames_have_none(sloped):
    m = sloped.manifest
    lines = [[level.slopes for level in segment.levels] for segment in list(m.segments)[:4]]
    assert lines == [[True, True], [True, True], [None, None], [True, True]]
    assert m.segments[3].levels[0].file.bytes
    (path,) = m.delta_files(0, 0)
    found, segment = mp4.read_segment(sloped.read(path)), m.segments[0].levels[0]
    assert len(found.samples) == len(found.checksums) == SEGMENT + 1
    assert len(segment.frame_bytes) == SEGMENT and segment.frame_bytes[0] > len(found.samples[0]) // 2


def test_every_error_is_within_its_bound_and_segments_of_one_frame_have_files_and_no_line(package_of):
    measured = {}
    for name in ("slopes", "few"):
        package = open_package(package_of(name))
        assert faces.validate(package.files.path) == []
        measured[name] = list(measure_errors(package, PACKAGES[name].scene()))
        assert all(m.error <= m.bound for m in measured[name]), [m for m in measured[name] if m.error > m.bound]
    assert max(m.error / m.bound for m in measured["slopes"] if "delta" in m.where and m.bound) > 0.5
    segments = package.manifest.segments
    assert [segment.levels[0].slopes for segment in segments] == [None] * 19
    sent = [s for s, segment in enumerate(segments) if segment.levels[0].file.bytes]
    assert len(sent) > 2 and decode_slopes(package, sent[-1], 0) is None


def test_frames_that_are_read_alone_are_those_of_a_whole_segment_and_slopes_are_what_rows_rise_by(sloped):
    whole = [frame.gaussians for frame in decode_frames(sloped, 0, 17)]
    for number in (0, 5, 7, 8, 12, 16):
        alone = decode(sloped, number)
        for name in alone.__slots__:
            np.testing.assert_array_equal(getattr(alone, name), getattr(whole[number], name))
    codes = np.stack([shown.codes() for shown in faces.decode_pictures(sloped, 0, 0, range(SEGMENT))])
    slopes, gain = decode_slopes(sloped, 0, 0), sloped.manifest.delta_gain
    assert np.ptp(slopes[:3], axis=1).max() > 20 * gain  # of means, some past 8 bits
    left = sample.fit_slopes(codes[:, :3].astype(np.float64))
    assert np.abs(left).mean() < gain / 2 < np.abs(slopes[:3]).mean()


def test_a_row_that_jumps_far_and_back_is_escaped_not_clipped(sloped):
    frames, shown = PACKAGES["slopes"].groups()[3], [f.gaussians.means for f in decode_frames(sloped, 25, 30)]
    far = int(np.argmax(shown[3][:, 0]))
    most = 3 * sloped.manifest.groups[3].delta_steps.means * decode_canonical(sloped, 3, 0).motion_units[far]
    for t in (3, 2):
        assert np.abs(shown[t][far] - frames[t].means[11]).max() <= most


def test_a_plan_has_lines_where_they_save_bytes():
    """Where everything moves evenly, and not where it shakes or is shown for a moment."""
    first, rng, settings = random_gaussians(600), np.random.default_rng(0), replace(SETTINGS, calibrate="steps")
    rise, shake = rng.normal(size=(600, 3)) * 0.02, rng.normal(size=(8, 600, 3)) * 0.05
    for moves, sloped in (([t * rise for t in range(8)], True), (shake, False), ([t * rise for t in range(3)], False)):
        frames = [replace(first, means=(first.means + way).astype(np.float32)) for way in moves]
        sequence = faces.GaussianSequence.from_arrays(frames, cameras=faces.orbit_views(first, count=4, size=64))
        assert faces.decide(sequence, replace(settings, segment_s=1.0)).sloped == sloped


def test_a_line_is_coded_with_the_frames_that_it_leaves():
    rng = np.random.default_rng(0)
    even = rng.normal(size=(3, 512)) * 30 + atlas.slope_times(12)[:, None, None] * rng.normal(size=(3, 512)) * 20
    sizes, decoded = sample.encode_and_decode(even, np.ones(3), h264.delta_codec("fast"), slopes=True)
    assert len(sizes) == 12 and np.abs(decoded - even).max() < 4


def noise(reach, kind, count=6):
    """A GOP of `count` pictures whose samples differ from 128 by at most `reach`."""
    rng, shape = np.random.default_rng(reach), (count, 128, 128)
    signed = rng.choice([-1.0, 1.0], shape) if kind == "ends" else rng.uniform(-1, 1, shape)
    return h264.ClosedGop(np.rint(128 + reach * signed).astype(np.uint8), 0, 1)


NOISES = (escapes.LIMIT, "ends"), (escapes.LIMIT, "even"), (106, "ends"), (60, "ends")


def test_pictures_that_would_leave_the_range_are_coded_finer_and_the_limit_of_escapes_leaves_room_for_errors():
    """They alone: the segments beside them keep their bytes."""
    ends, even, bright, calm = (noise(*n) for n in NOISES)
    coarse = [h264.encode_gop(gop, (128, 128), FPS, CODEC) for gop in (ends, even, calm, bright)]
    checked = zip(coarse, (ends, even, calm, bright), strict=True)
    assert [h264.check_gop(data, gop, CODEC).in_range for data, gop in checked] == [True, True, True, False]
    coded = streams.encode_checked([bright, calm], (128, 128), streams.FrameClock.of(FPS), CODEC).gops
    shown = list(coded[0].pictures("x"))
    assert len(shown) == 6 and all(h264.in_range(picture) for picture in shown)
    assert len(coded[0].fragment) > len(coarse[3].fragment) and coded[1].fragment == coarse[2].fragment


def test_an_atlas_that_is_too_large_for_a_picture_is_decoded_from_pages(tmp_path, monkeypatch):
    """Every keyframe and level is, here, and every value keeps to its `max_error`."""
    monkeypatch.setattr(streams, "picture_size", partial(atlas.picture_size, macroblocks=16))
    sequence = faces.GaussianSequence.from_arrays(moving_frames(600, 5))
    faces.encode(sequence, tmp_path / "out", replace(PLAIN, keep_all=False, segment_s=0.1))
    assert faces.validate(tmp_path / "out") == []
    package = open_package(tmp_path / "out")
    assert all(found.error <= found.bound for found in measure_errors(package, sequence))
    group = package.manifest.groups[0]
    assert all(atlas.pages > 1 and atlas.height == 64 for atlas in (*group.tiers[0].qualities, group.levels[0]))
    assert len(package.manifest.segments) > 1
