"""The paper's server for one viewer: messages that decode to what was sent, and a drift that is measured."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from airgs_codec.errors import FormatError
from airgs_codec.package.package import open_package
from airgs_codec.package.region import draw_views
from tests.support.paths import VALID
from tools.lab.paper import closed_loop
from tools.lab.paper.closed_loop import (
    ClosedLoopSettings,
    Server,
    Viewer,
    adaptive,
    always,
    closed_loop_table,
    decode_change,
    encode_change,
    run_closed_loop,
)
from tools.lab.paper.states import SHARES, kept_rows, load_states, score_rows


@pytest.fixture(scope="module")
def moving():
    return open_package(VALID / "moving")


@pytest.fixture(scope="module")
def settings(moving):
    cameras = draw_views(moving.manifest.region, 3, 5)
    return ClosedLoopSettings(cameras, cameras[:1])


@pytest.fixture(scope="module")
def group(moving, settings):
    """States of the first group, and the rows kept for every share."""
    states = load_states(moving, 0)
    score = score_rows(states, list(settings.training))["hits"]
    return states, {share: kept_rows(score, share) for share in SHARES}


STEPS = st.integers(-(2**30), 2**30)


@given(
    change=npst.arrays(np.int32, st.tuples(st.integers(1, 30), st.integers(0, 12)), elements=STEPS),
    share=st.sampled_from(SHARES),
)
def test_a_message_decodes_to_the_rows_that_it_sends(change, share):
    score = np.arange(change.shape[1], dtype=float)
    kept = {s: kept_rows(score, s) for s in SHARES}
    message = encode_change(change, kept, share)
    assert np.array_equal(decode_change(message, kept, len(change)), np.where(kept[share], change, 0))
    assert (message == b"") == (share == 1)


def test_a_message_that_is_cut_short_is_refused(group):
    states, kept = group
    message = Server(states, kept).message(1, 0.0)
    with pytest.raises(FormatError):
        decode_change(message[:-3], kept, len(states.steps))


def test_the_viewer_has_what_the_server_thinks(moving, settings):
    """Random shares for every frame: no drift, and at 0 % everything is there again."""
    random = np.random.default_rng(1)

    def choose(server, t, budget):
        return 0.0 if t % 4 == 3 else SHARES[int(random.integers(len(SHARES)))]

    served = run_closed_loop(moving, choose, settings)
    assert all(frame.drift == 0 for frame in served)
    assert any(frame.stale > 0 for frame in served)
    assert all(frame.stale == 0 for frame in served if frame.pruned == 0)
    assert all((frame.bytes == 0) == (frame.pruned == 1) for frame in served)
    full = closed_loop_table(run_closed_loop(moving, always(0.0), settings))
    nothing = closed_loop_table(run_closed_loop(moving, always(1.0), settings))
    assert full["psnr_to_top"] > nothing["psnr_to_top"] + 3 and nothing["kb_frame"] == 0


def test_drift_is_measured_at_the_viewer(moving, settings, monkeypatch):
    """A decoder that loses the last row of every message must show in the figures, and on the screen."""
    exact = closed_loop_table(run_closed_loop(moving, always(0.0), settings))

    def forgetful(message, kept, channels):
        change = decode_change(message, kept, channels)
        change[:, -1] = 0
        return change

    monkeypatch.setattr(closed_loop, "decode_change", forgetful)
    damaged = closed_loop_table(run_closed_loop(moving, always(0.0), settings))
    assert exact["drift_steps"] == 0 < damaged["drift_steps"]
    assert damaged["psnr_to_top"] < exact["psnr_to_top"]
    assert damaged["stale"] == exact["stale"] == 0  # the server does not know


def test_a_lost_message_is_missing_ever_after(group):
    states, kept = group
    server, viewer = Server(states, kept), Viewer(states, kept)
    for t in range(3):
        message = server.send(t, 0.0)
        if t != 1:
            viewer.receive(message)
    assert np.array_equal(server.sent - viewer.held, server.wanted[1] - server.wanted[0])
    assert (server.sent != viewer.held).any()


def test_the_least_share_that_fits_is_chosen(group):
    states, kept = group
    server = Server(states, kept)
    last = len(states.values) - 1
    sizes = [len(server.message(last, share)) for share in SHARES]
    assert sizes[-1] == 0 and sizes[0] == max(sizes)
    assert sizes == sorted(sizes, reverse=True) and len(set(sizes)) > 5
    for budget in (0, sizes[5], sizes[1], sizes[0], 1e9):
        share = adaptive(server, last, budget)
        assert share == SHARES[next(i for i, size in enumerate(sizes) if size <= budget)]
