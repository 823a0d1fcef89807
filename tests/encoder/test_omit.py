"""What is left out is noted, and only where it may be; states are worked out a part at a time, as if all at once."""

from dataclasses import fields, replace
from fractions import Fraction

import numpy as np
import pytest

from airgs_codec.coding import kernels
from airgs_codec.coding.channels import state_channels
from airgs_codec.encoder.omit import StateValues
from airgs_codec.encoder.plan import keep_rows, lay_out
from airgs_codec.encoder.representation import Clock
from airgs_codec.encoder.states import code_states
from airgs_codec.scene import sequence as sequences
from tests.faces import (
    STATIC,
    EncodeSettings,
    GroupSpan,
    LevelSettings,
    decode_frames,
    encode,
    open_package,
    open_sequence,
    plan_views,
    survey_group,
    validate,
)
from tests.support.paths import FOX
from tests.support.scenes import moving_frames, write_sequence

FAST = EncodeSettings(preset="veryfast", threads=2)


def test_keep_all_keeps_all(demo_package, tmp_path):
    settings = replace(FAST, keep_all=True, measure_pictures=0, calibrate="none")
    everything, less = (
        encode(open_sequence(FOX), tmp_path / "all", settings).manifest,
        open_package(demo_package).manifest,
    )
    assert all(g.unused == 0 for g in everything.groups)
    assert {entry.what for group in everything.groups for entry in group.left_out} <= {"updates"}
    assert all(g.unused > 0 for g in less.groups)
    noted = [entry for group in less.groups for entry in group.left_out if entry.what == "gaussians"]
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
    assert any(line.startswith("2 SH bands left out: ") for line in package.manifest.decisions)
    assert next(decode_frames(package, 0, 1)).gaussians.sh_rest.shape[1] == 3


LEVELS = (LevelSettings(0.0), LevelSettings(0.5, 2.0, quality=1))
SETTINGS = EncodeSettings(calibrate="none", levels=LEVELS, segment_s=0.1, byte_price=1e-8, decide_pictures=2)


@pytest.fixture(scope="module")
def sequence(tmp_path_factory):
    """Six frames in which some rows come and go, some jump far and one is never drawn."""
    random = np.random.default_rng(3)
    frames = moving_frames(700, 6, degree=1)
    shown = []
    for t, g in enumerate(frames):
        logits, means = g.opacity_logits.copy(), g.means.copy()
        logits[random.integers(0, 700, 60)] = -9.0
        logits[5] = -9.0
        means[7] += 100.0 * (t > 2)
        shown.append(replace(g, opacity_logits=logits, means=means))
    return open_sequence(write_sequence(tmp_path_factory.mktemp("states") / "scene", shown))


@pytest.fixture(scope="module")
def group(sequence):
    """Its frames, how they are laid out, and the canonical space of two key qualities."""
    survey = survey_group(sequence, GroupSpan(0, 0, 6), plan_views(sequence, SETTINGS))
    loaded = sequence.load(range(6))
    layout = lay_out(loaded, survey, keep_rows(loaded.frames, survey, SETTINGS.row_error), SETTINGS, sequence.fps)
    fine = layout.key_values().astype(np.float32)
    still = np.full(len(layout.rows), STATIC, np.uint8)
    return loaded.frames, layout, [layout.canonical_space(key, still) for key in (fine, np.round(fine, 1))]


@pytest.fixture
def small_chunks(monkeypatch):
    monkeypatch.setattr(kernels, "CHUNK", 1)
    monkeypatch.setattr(kernels, "LEAST", 37)


def test_values_are_those_of_all_frames_together(group, tmp_path, small_chunks):
    frames, layout, (base, _) = group
    shown = [frame.take(layout.rows) for frame in frames]
    expected = state_channels(shown, base, layout.state_steps)
    values = StateValues.write(tmp_path / "values", frames, layout.rows, base, layout.state_steps)
    np.testing.assert_allclose(values.part(slice(None)), expected, rtol=0, atol=1e-12)
    whole = values.part(slice(None))
    some = np.arange(3, len(layout.rows), 5)
    np.testing.assert_array_equal(values.channel(9, some), whole[:, 9, some])
    np.testing.assert_array_equal(values.frame(4), whole[4])
    np.testing.assert_array_equal(values.part(slice(10, 20), slice(2, 5)), whole[2:5, :, 10:20])
    assert sum(part.stop - part.start for part in values.chunks()) == len(layout.rows) > 37


def test_how_many_rows_are_looked_at_together_changes_nothing(group, tmp_path, small_chunks, monkeypatch):
    frames, layout, bases = group
    coded = []
    for name in ("few", "many"):
        (tmp_path / name).mkdir()
        coded.append(code_states(layout, bases, frames, SETTINGS, Clock.of(Fraction(30)), tmp_path / name))
        monkeypatch.undo()
    few, many = coded
    assert few.depths.tolist() == many.depths.tolist() and few.left_out == many.left_out
    assert any(level.escapes and any(level.escapes) for level in many.levels)
    for a, b in zip(few.levels, many.levels, strict=True):
        assert a.atlas == b.atlas and a.escapes == b.escapes
        assert a.samples is not None and b.samples is not None
        assert [x.tolist() for x in a.samples] == [x.tolist() for x in b.samples]
        assert [x.tolist() for x in a.samples.part(2, 4)] == [x.tolist() for x in b.samples][2:4]


def test_frames_that_are_read_again_are_the_same(sequence, monkeypatch):
    kept = sequence.load(range(1, 6))
    monkeypatch.setattr(sequences, "HELD_BYTES", 0)
    again = sequence.load(range(1, 6))
    assert isinstance(kept.frames, list) and not isinstance(again.frames, list)
    assert again.notes == kept.notes and len(again.frames) == 5
    assert again.frames[2] is again.frames[2]  # the last one is kept
    for a, b in zip(again.frames[1:4], kept.frames[1:4], strict=True):
        assert all(np.array_equal(getattr(a, f.name), getattr(b, f.name)) for f in fields(a))
