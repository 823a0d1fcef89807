"""The decoding benchmark: which frame it takes, and that it runs on every package of the corpus."""

import pytest

from tests.support.manifests import tiny_manifest
from tests.support.paths import VALID
from tools.lab.bench.decode import Options, middle_frame, run
from tools.lab.command import Lab


@pytest.mark.parametrize("groups", [(30,), (1,), (2,), (10, 5), (10, 10, 10)])
def test_the_frame_that_is_timed_alone_is_in_the_middle_of_a_segment(groups):
    m = tiny_manifest(groups=groups)
    index, frame = middle_frame(m)
    segment = m.segments[index]
    assert segment.start <= frame < segment.stop <= m.frames
    assert abs(frame - (segment.start + segment.stop - 1) / 2) <= 0.5


@pytest.mark.parametrize("package", ["one-gaussian", "two-groups-sh1"])
def test_every_part_is_measured(package, tmp_path):
    page = run(Options((VALID / package,), repeat=1), Lab.at(tmp_path))
    rows = page.sections[0].tables[0].rows
    assert len(rows) == 8 and all(row["ms a frame"] > 0 for row in rows if row["part"] in ("all", "one frame"))
    assert page.sections[0].answer.startswith(f"{package}: ")
