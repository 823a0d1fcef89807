"""Whole packages: files, pictures and frames are those of the vectors."""

from hashlib import sha256

import numpy as np
import pytest

from airgs_codec.coding.channels import colours
from airgs_codec.media.h264 import open_segment
from airgs_codec.package import package as opening
from tests.faces import GroupIndex, decode_frames, group_path, open_package
from tests.support.long_index import long_index
from tests.support.paths import REPOSITORY, VECTORS
from tests.support.vectors import cases, data

FRAMES = np.frombuffer((VECTORS / "packages.bin").read_bytes(), "<f4")
MOST_REQUESTS = 6, 9  # before the first picture: of a group without kept rows, and of one with


def package(case):
    return open_package(REPOSITORY / case["package"])


def label(case):
    names = ("package", "count", "number", "path", "frame", "quality", "level", "tiers")
    return " ".join(str(case[name]) for name in names if name in case)


def show(case):
    rung = {"level": case["level"], "key_quality": case["quality"], "tiers": case["tiers"]}
    return next(decode_frames(package(case), case["frame"], case["frame"] + 1, **rung)).gaussians


@pytest.mark.parametrize("case", cases("packages", "groups"), ids=label)
def test_groups_and_their_files(case):
    m, number = package(case).manifest, case["number"] - 1
    group, levels = m.groups[number], range(len(m.levels))
    assert (group.start, group.stop, group_path(number + 1)) == (case["start"], case["stop"], case["table"])
    for tier, (sidecar, pictures) in enumerate(zip(case["sidecars"], case["pictures"], strict=True)):
        for quality, picture in enumerate(pictures):
            assert m.key_files(number, tier, quality) == [path for path in (sidecar, picture) if path]
    for segment, expected in zip(m.segments_of(number), case["segments"], strict=True):
        found = m.segments[segment]
        assert (found.start, found.stop) == (expected["start"], expected["stop"])
        assert [m.state_files(segment, j) for j in levels] == [[path] if path else [] for path in expected["files"]]


@pytest.mark.parametrize("case", cases("packages", "index"), ids=label)
def test_the_way_to_a_group_of_a_long_package(case):
    index, pages = long_index(case["count"])
    places = GroupIndex(index, lambda path, _: pages[path])
    assert [len(spans) for spans in index] == case["entries"] and places.groups == case["count"]
    assert places.at_frame(case["frame"]) == places.at_segment(case["frame"]) == case["number"] - 1
    assert list(places.pages_to("segments", case["frame"])) == case["pages"]
    assert list(places.pages_to("groups", case["number"] - 1)) == case["pages"]


@pytest.mark.parametrize("case", cases("packages", "startup"), ids=label)
def test_what_is_fetched_before_the_first_picture(case, monkeypatch):
    asked, read_file = [opening.JSON_NAME], opening.read_file
    monkeypatch.setattr(
        opening, "read_file", lambda folder, path, entry: (asked.append(path), read_file(folder, path, entry))[1]
    )
    show(case)
    assert asked == case["files"]
    tables = [path for path in asked if path.startswith("group/")]
    assert case["tiers"] > 1 or len(asked) <= MOST_REQUESTS[len(tables) - 1]


@pytest.mark.parametrize("case", cases("packages", "units"), ids=label)
def test_pictures_and_columns(case):
    columns, shown = open_segment(package(case).read(case["path"]), case["path"])
    assert columns == (None if case["columns"] is None else data(case["columns"]))
    pictures = list(shown)
    assert {picture.shape for picture in pictures} == {(case["height"], case["width"])}
    assert [sha256(picture.tobytes()).hexdigest() for picture in pictures] == case["luma"]


@pytest.mark.parametrize("case", cases("packages", "frames"), ids=label)
def test_frames(case):
    g = show(case).take(np.array(case["rows"]))
    alpha = 1 / (1 + np.exp(-g.opacity_logits.astype(np.float64)))
    parts = {"means": g.means, "quaternions": g.quaternions, "log_scales": g.log_scales, "alpha": alpha}
    at = case["offset"] // 4
    for name, got in (parts | {"colours": colours(g.sh_dc, g.sh_rest)}).items():
        expected = FRAMES[at : at + got.size].reshape(got.shape)
        assert np.abs(got - expected).max() <= case["tolerance"][name], name
        at += got.size
