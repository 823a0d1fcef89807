"""The decoding benchmark: which frame it takes, and that it runs on every package of the corpus."""

import json

import pytest

from tests.support.manifests import tiny_manifest
from tests.support.paths import VALID
from tools.bench_decode import main, middle_frame


@pytest.mark.parametrize("groups", [(30,), (1,), (2,), (10, 5), (10, 10, 10)])
def test_the_frame_that_is_timed_alone_is_in_the_middle_of_a_segment(groups):
    m = tiny_manifest(groups=groups)
    index, frame = middle_frame(m)
    segment = m.segments[index]
    assert segment.start <= frame < segment.stop <= m.frames
    assert abs(frame - (segment.start + segment.stop - 1) / 2) <= 0.5


@pytest.mark.parametrize("package", ["one-gaussian", "two-groups-sh1"])
def test_it_runs(package, capsys):
    main([str(VALID / package), "--repeat", "1"])
    figures = json.loads(capsys.readouterr().out)
    assert figures["sequence"] > 0 and figures["random"] > 0
