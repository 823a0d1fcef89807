"""Every extreme sequence comes back within its bound, or is refused for its reason; nothing is silently not finite."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from tests import faces
from tests.support.regions import region
from tests.support.scenes import write_sequence
from tools.lab.numerics.extremes import LINES, page, row
from tools.lab.numerics.sequences import CASES, PLAIN, Outcome, measure_case
from tools.lab.published import read_figures

LONG = "1000 frames"  # of which 260 are coded here: more than a byte counts
SEEN = {"region": region(), "decide_pictures": 2}
QUICK = replace(PLAIN, levels=PLAIN.levels[::3], keyframes=faces.INTRA, **SEEN)
ONE_RUNG = {"levels": PLAIN.levels[:1], "keyframe_factors": (1.0,)}


def is_plain(case):
    """Whether it needs nothing of its own, so that it may be a group of one package with others."""
    own = case.search or case.refused or case.name == LONG or "rows are not those" in case.repaired
    return case.settings == PLAIN and not own


PLAIN_CASES = [case for case in CASES if is_plain(case)]
OTHERS = [case for case in CASES if not is_plain(case)]


@pytest.mark.parametrize("degree", [0, 1, 3])
def test_extremes_that_share_a_package(degree, tmp_path):
    """Each is a group that is coded by itself."""
    cases = [case for case in PLAIN_CASES if case.frames()[0].sh_degree == degree]
    groups = [case.frames() for case in cases]
    starts = np.cumsum([0, *map(len, groups)]).tolist()
    frames = [frame for group in groups for frame in group]
    sequence = faces.open_sequence(write_sequence(tmp_path / "scene", frames, keyframes=starts[:-1]))
    faces.encode(sequence, tmp_path / "out", QUICK)
    assert faces.validate(tmp_path / "out") == []
    package = faces.open_package(tmp_path / "out")
    assert [(group.start, group.stop) for group in package.manifest.groups] == list(pairwise(starts))
    for frame in faces.decode_frames(package, 0, len(frames)):
        assert all(np.isfinite(getattr(frame.gaussians, name)).all() for name in frame.gaussians.__slots__)
    measured = list(faces.measure_errors(package, sequence))
    for number, (case, group) in enumerate(zip(cases, package.manifest.groups, strict=True)):
        own = [one for one in measured if one.where.split()[:2] == ["group", str(number)]]
        assert own and sum(one.rows for one in own) > 0, case.name
        assert [one for one in own if one.error > one.bound] == [], case.name
        assert case.repaired in "; ".join(group.repairs), case.name


def quick(case):
    levels = {"levels": QUICK.levels} if case.settings.levels == PLAIN.levels else {}
    rungs = ONE_RUNG if case.name == LONG or len(case.settings.tiers) > len(PLAIN.tiers) else levels
    return replace(case.settings, **rungs, **({} if case.search else SEEN))


@pytest.mark.parametrize("case", OTHERS, ids=lambda case: case.name)
def test_extreme(case, tmp_path):
    most = 260 if case.name == LONG else None
    outcome = measure_case(replace(case, settings=quick(case), frames=lambda: case.frames()[:most]), tmp_path)
    assert case.refused in outcome.refusal and bool(case.refused) == bool(outcome.refusal), outcome
    assert case.repaired in outcome.repairs, outcome
    assert outcome.finite
    assert outcome.worst <= 1, outcome
    if not case.refused:
        assert outcome.compared > 0 and outcome.bytes_a_gaussian > 0


def test_ten_lines_hold_every_sequence_and_all_are_published():
    assert len(LINES) == 10
    assert sorted(name for line in LINES for name in line.names) == sorted(case.name for case in CASES)
    table = read_figures()["extremes"]["tables"]["extremes"]
    published = [dict(zip(table["columns"], values, strict=True)) for values in table["rows"]]
    assert [(one["sequence"], one["verdict"]) for one in published] == [
        (case.name, "refused" if case.refused else "bounded") for case in CASES
    ]


@pytest.mark.parametrize(("refused", "outcome", "verdict", "good"), [
    ("", {}, "bounded", True),
    ("", {"worst": 1.01}, "out of its bound", False),
    ("", {"finite": False}, "out of its bound", False),
    ("", {"refusal": "too many codes"}, "refused", False),
    ("codes", {"refusal": "too many codes"}, "refused", True),
    ("codes", {"refusal": "no such file"}, "refused", False),
    ("codes", {}, "bounded", False),
])  # fmt: skip
def test_a_sequence_that_ends_otherwise_than_it_should_fails_the_page(refused, outcome, verdict, good):
    end = Outcome("", worst=1.0, bytes_a_gaussian=31.4)
    rows = [row(case, replace(end, name=case.name, refusal=case.refused)) for case in CASES]
    assert not page(rows).failed
    rows[0] = row(replace(CASES[0], refused=refused), replace(end, name=CASES[0].name, **outcome))
    assert (rows[0]["verdict"], rows[0]["good"]) == (verdict, good)
    made = page(rows)
    assert made.failed is not good
    inside = [line["within bounds"] for line in made.sections[0].tables[0].rows]
    assert sum(inside) == [one["verdict"] for one in rows].count("bounded")
    assert made.sections[0].tables[0].rows[6]["what to do"] == "track them, or pay up to 31 bytes a row and frame"
