"""Tables that come over a connection: what they lead to is read, and only the same package may grow."""

from dataclasses import replace
from functools import cache

import pytest

from tests.faces import JSON_NAME, FormatError, Manifest, RemoteTables, group_path, open_package, pack_json, root_of
from tests.support.long_index import long_index
from tests.support.paths import VALID
from tests.support.refusals import cases

ROOT = root_of(open_package(VALID / "paged").manifest)


@cache
def root(count, **fields):
    """An airgs.json of so many groups of a frame each, while more are to come."""
    index, _ = long_index(count)
    return pack_json(replace(ROOT, live=True, frames=count, index=index, **fields))


def spoilt(count, level):
    """The same after another entry was the first of a level."""
    index = list(long_index(count)[0])
    index[level] = replace(index[level], sha256="_" + index[level].sha256[1:])
    return pack_json(replace(ROOT, live=True, frames=count, index=index))


def grown(*roots):
    tables = RemoteTables()
    for data in roots:
        tables.accept(JSON_NAME, data)
    return tables


def test_pages_of_every_level_lead_to_groups_as_a_package_grows():
    tables, (_, pages) = grown(root(4095)), long_index(4097)
    places = tables.offers.manifest.groups.places
    tables.accept("index/1/2.json", pack_json(pages["index/1/2.json"]))
    assert places.at_frame(64) == 64
    tables.accept(JSON_NAME, root(4097))
    places = tables.offers.manifest.groups.places
    assert places.at_frame(4096) == 4096
    with pytest.raises(FormatError, match="has not been fetched"):
        places.at_frame(64)
    with pytest.raises(FormatError, match="has not been fetched"):
        tables.accept("index/1/64.json", pack_json(pages["index/1/64.json"]))
    for path in ("index/2/1.json", "index/1/64.json"):
        tables.accept(path, pack_json(pages[path]))
    assert [places.at_frame(frame) for frame in (64, 4095)] == [64, 4095]  # the page of before is as good as ever


@pytest.mark.parametrize("order", [(1, 2, 3), (3, 2, 1), (2, 1, 3)])
def test_a_table_is_checked_with_those_that_keep_its_rows_and_with_no_others(monkeypatch, order):
    """Groups 2 and 3 keep rows of group 1."""
    folder, tables, checked = VALID / "kept", RemoteTables(), []
    monkeypatch.setattr(Manifest, "base_of", lambda _, group: checked.append(group))
    tables.accept(JSON_NAME, (folder / JSON_NAME).read_bytes())
    for number in order:
        checked.clear()
        tables.accept(group_path(number), (folder / group_path(number)).read_bytes())
        there = set(order[: order.index(number) + 1])
        pairs = [keeper for keeper in (2, 3) if {1, keeper} <= there and number in (1, keeper)]
        assert sorted(checked) == [keeper - 1 for keeper in pairs]


@pytest.mark.parametrize("order", [(2, 3), (3, 2)])
def test_a_table_that_keeps_rows_of_one_that_keeps_some_is_refused_whichever_comes_first(order):
    files, tables = cases()["bad_value-keeps-chain"].package(), RemoteTables()
    tables.accept(JSON_NAME, files[JSON_NAME])
    first, second = (group_path(number) for number in order)
    tables.accept(first, files[first])
    for _ in range(2):
        with pytest.raises(FormatError) as refused:
            tables.accept(second, files[second])
        assert refused.value.reason == "bad_value"


def test_a_page_that_is_not_what_the_level_above_says_is_refused():
    tables, (_, pages) = grown(root(4097)), long_index(4097)
    page = pages["index/2/1.json"]
    for data in (pack_json(page)[:-1], pack_json(replace(page, sha256="_" + page.sha256[1:]))):
        with pytest.raises(FormatError) as refused:
            tables.accept("index/2/1.json", data)
        assert refused.value.reason in ("size_mismatch", "hash_mismatch")
    with pytest.raises(FormatError, match="no table has such a file"):
        tables.accept("index/2/2.json", pack_json(page))


@pytest.mark.parametrize(
    "after",
    [root(4161), root(70), spoilt(4163, 0), spoilt(4300, 2), spoilt(4227, 1), root(4163, attribution="other")],
    ids=["fewer", "far fewer", "groups", "pages of pages", "pages", "author"],
)
def test_another_package_is_no_growth(after):
    with pytest.raises(FormatError, match="expected the package of before with more groups"):
        grown(root(4162), after)


def test_a_package_that_was_closed_does_not_grow_again():
    with pytest.raises(FormatError, match="expected the package of before with more groups"):
        grown(root(4162).replace(b'"live":true', b'"live":false'), root(4163))


def test_growth_may_be_long_in_coming():
    for count in (4162, 4163, 4227, 9000):
        tables = grown(root(4162), root(count))
        assert tables.offers.manifest.groups.places.groups == count
