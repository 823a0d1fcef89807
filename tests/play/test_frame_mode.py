"""The paper's frame mode, by hand."""

import numpy as np
import pytest

from airgs_codec.errors import ConfigError
from airgs_codec.play.catalogue import Catalogue
from airgs_codec.play.frame_mode import SKIPPED, frame_options, frame_table, simulate_frames
from airgs_codec.play.link import Link
from airgs_codec.play.trace import Trace
from tests.support.manifests import tiny_manifest

CATALOGUE = Catalogue(tiny_manifest())  # 10 fps; state 200, 100, 50 B a frame and 10 B of sidecar


def link(rates, starts=None):
    starts = list(range(len(rates))) if starts is None else starts
    return Link(Trace("t", np.array(starts, float), np.array(rates, float), 1000.0))


def test_what_a_frame_weighs():
    levels = frame_options(CATALOGUE, keys=False)
    assert len(levels) == 20 and [p.size_bytes for p in levels[0]] == [210, 110, 60]
    assert [p.quality for p in levels[0]] == [40, 38, 34]
    with_keys = frame_options(CATALOGUE, keys=True)
    assert [p.size_bytes for p in with_keys[0]] == [630, 530, 480]  # 4200 B of keys over ten frames


def test_a_constant_link():
    """1250 B/s: 125 B a frame. Level 1 takes 88 ms, level 0 168 ms and holds up what follows."""
    best = simulate_frames(CATALOGUE, link([1e4]), "paper", 1)
    assert set(best.levels) == {1} and best.fits.all() and not best.late.any()
    assert best.sent_s == pytest.approx(np.full(20, 0.088)) and best.paper_s == pytest.approx(best.sent_s)
    top = simulate_frames(CATALOGUE, link([1e4]), "unpruned", 1)
    assert top.sent_s == pytest.approx(np.full(20, 0.168)) and top.late.all()
    assert top.waited_s == pytest.approx(0.068 * np.arange(20))
    least = simulate_frames(CATALOGUE, link([1e4]), "pruned", 1)
    assert set(least.levels) == {2}


def test_nothing_fits_an_outage():
    rates = link([1e4, 0, 1e4], [0, 0.5, 1.0])
    best, literal = (simulate_frames(CATALOGUE, rates, name, 1) for name in ("paper", "paper-literal"))
    assert best.levels.tolist() == [1] * 5 + [SKIPPED] * 5 + [1] * 10
    assert best.sizes[5:10].sum() == 0 and np.isnan(best.quality[5:10]).all()
    assert np.isinf(literal.paper_s[5:10]).all() and literal.waited_s.max() > 0.4
    table = frame_table(best)
    assert table["skipped"] == table["infeasible"] == 0.25 and table["late"] == 0
    assert table["paper_max_ms"] == pytest.approx(88) and table["kb_frame"] == pytest.approx(0.0825)
    assert frame_table(literal)["outage"] == 0.25


def test_an_estimated_rate_recovers_after_an_outage():
    log = simulate_frames(CATALOGUE, link([1e5, 0, 1e5], [0, 0.5, 0.8]), "paper", 4, known=False)
    assert log.levels[0] == SKIPPED  # nothing is known yet
    assert (log.levels[-20:] == 0).all()


def test_what_cannot_be_played():
    with pytest.raises(ConfigError, match="expected unpruned"):
        simulate_frames(CATALOGUE, link([1e4]), "best", 1)
    with pytest.raises(ConfigError, match="no measured quality"):
        simulate_frames(Catalogue(tiny_manifest(psnr=None)), link([1e4]), "paper", 1)
