"""Rules and constants that decide, each by what would come out if it were another."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from airgs_codec._sampling import evenly_spaced, middle_frames
from airgs_codec.coding.channels import hold_undrawn
from airgs_codec.encoder import layout, omit
from airgs_codec.trainer.fit.losses import codec_steps
from tests import faces
from tests.support.manifests import link, rules, tiny_manifest
from tests.support.paths import VALID
from tests.support.scenes import random_gaussians, write_sequence
from tests.support.views import ring


def test_a_row_has_its_first_drawn_value_before_it_is_drawn_and_its_last_one_after():
    channels = np.array([[[9.0]], [[1.0]], [[9.0]], [[2.0]], [[9.0]]])
    hold_undrawn(channels, np.array([[False], [True], [False], [True], [False]]))
    assert channels.ravel().tolist() == [1, 1, 1, 2, 2]


def test_bands_go_where_they_cost_less_than_half_of_what_their_bytes_are_worth(tmp_path):
    sequence = faces.open_sequence(write_sequence(tmp_path / "scene", [random_gaussians(200, degree=1)]))
    settings = faces.EncodeSettings(decide_pictures=4)
    frames = faces.Frames(sequence, 0, ((0, 1),))
    survey = faces.Survey.of(frames, faces.choose_views(sequence, settings)[0], faces.CPU)

    def left(price):
        return omit.omit_bands(frames, survey, replace(settings, byte_price=price))

    words = left(1e3)[1].split()
    error, size = 10 ** (-float(words[words.index("dB") - 1]) / 10), 1e3 * float(words[words.index("kB/frame") - 1])
    assert [left(share * error / size)[0] for share in (1.5, 2.5)] == [1, 0]


def test_a_policy_knows_the_downloads_that_are_over_and_before_them_the_tables_with_their_wait():
    seen = []

    def watch(state):
        seen.append(state.history)
        return faces.Decision(0, True, "watch", state.options[0].size_bytes)

    offers, slow = faces.Offers(tiny_manifest(groups=(10, 10, 10)), 0, 1000), link([8e4], rtt=0.1)
    log = faces.simulate(offers, slow, faces.Policy("watch", watch), rules(pipelined=True))
    tables, first = (next(f for f in log.fetches if (f.kind == "tables") is is_table) for is_table in (True, False))
    assert [len(history) for history in seen] == [1, 1, 1]  # the second is on its way when the third is asked for
    assert seen[0][0].seconds == pytest.approx(tables.arrival_s - tables.request_s)
    assert seen[1][0].bytes == seen[2][0].bytes == first.bytes


def test_factors_of_tiers_are_at_most_three_apart_and_steps_of_opacity_finite_where_its_slope_is_none():
    factors = layout.tier_factors(np.array([1e6, 1.0]), np.array([0, 1]), 2)
    assert max(factors) / min(factors) == pytest.approx(3, rel=0.01)
    g = replace(random_gaussians(2), opacity_logits=np.array([20, 0], np.float32))
    saturated, half = codec_steps(g, ring(2))["opacity_logits"].tolist()
    assert saturated / half == pytest.approx(0.25 / 0.02)


def test_frames_cannot_be_written_to_and_few_groups_stay_decoded(monkeypatch):
    package = faces.open_package(VALID / "two-groups-sh1")
    for frame in faces.decode_frames(package, 0, 1):
        with pytest.raises(ValueError, match="read-only"):
            frame.gaussians.log_scales[0] = 0
    counted, found = [], faces.decode_canonical
    monkeypatch.setattr("airgs_codec.decoder.decode.decode_canonical", lambda *of: counted.append(of) or found(*of))
    for most, wanted in ((-1, 4), (10**9, 2)):
        monkeypatch.setattr("airgs_codec.decoder.decode.DECODED_ROWS", most)
        again = faces.open_package(VALID / "two-groups-sh1")
        counted.clear()
        for frame in [0, package.manifest.frames - 1] * 2:
            faces.decode(again, frame)
        assert len(counted) == wanted


@given(st.integers(1, 500), st.integers(1, 50))
def test_evenly_spaced_picks_have_the_first_and_last_among_them(count, most):
    picks = evenly_spaced(count, most)
    assert len(picks) == min(count, most) and picks == sorted(set(picks)) and picks[0] == 0
    if most > 1:
        gaps = [b - a for a, b in pairwise(picks)]
        assert picks[-1] == count - 1 and (not gaps or max(gaps) - min(gaps) <= 2)


@given(st.integers(0, 100), st.integers(1, 200), st.integers(1, 50))
def test_middle_frames_lie_in_the_middle_of_equal_parts(start, length, most):
    picks, parts = middle_frames(start, start + length, most), min(most, length)
    assert len(picks) == parts
    for i, frame in enumerate(picks):
        assert abs(frame + 0.5 - (start + (i + 0.5) * length / parts)) <= 0.5
