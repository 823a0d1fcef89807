"""Sessions over packages of keys that are differences: what must be fetched for that, and no more."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests import faces
from tests.faces import NO_FILE, Decision, FormatError, Horizon, Offers, Policy, Slot, simulate, solve_horizon
from tests.support.manifests import in_groups, keys, link, missing, play, rules, tiny_manifest
from tests.support.session_packages import offers_of


def keeping(m, number=2, of=1, pictures=(True, False)):
    """The manifest with a group whose keys are differences; a tier of which nothing differs has no pictures."""
    groups, tiers = list(m.groups), []
    for tier, there in zip(groups[number - 1].tiers, pictures, strict=True):
        rows = {} if there else {"rows": 0, "planes": []}
        atlases = [
            replace(atlas, centres=[0, 0, 0, *atlas.centres], max_error=[0.0, *atlas.max_error], **rows)
            for atlas in tier.qualities
        ]
        files = tier.pictures if there else [NO_FILE] * len(tier.pictures)
        tiers.append(replace(tier, qualities=atlases, pictures=files))
    groups[number - 1] = replace(groups[number - 1], tiers=tiers, keeps=of)
    return replace(m, groups=in_groups(groups))


KEPT = keeping(tiny_manifest())
THREE = tiny_manifest(groups=(10, 10, 10))


def test_the_manifest_is_one():
    first, second = KEPT.groups
    faces.check_group(KEPT, KEPT.groups.places.entry(1), second, "group")
    faces.check_base(second, first, "group")
    with pytest.raises(FormatError, match="centres"):
        faces.check_group(KEPT, KEPT.groups.places.entry(1), replace(second, keeps=None), "group")


@pytest.mark.parametrize(("m", "options", "media", "tables"), [
    # Of 3000 + 1000 B of pictures the second group has the first tier's, with both sidecars: who has the base
    (KEPT, {}, [6300, 3000 + 200 + 2100], [1000, 100, 100]),
    (KEPT, {"loops": 2}, [6300, 5300, 6300, 5300], [1000, 100, 100]),  # and in each loop
    # Who joins there needs airgs.json, the table of the group, then that of its base, and the keys of that.
    (KEPT, {"first": 1}, [3000 + 200 + 4200 + 2100], [1000, 100, 100]),
    (keeping(keeping(THREE), 3), {"first": 1}, [9500, 5300], [1000, 100, 100, 100]),
])  # fmt: skip
def test_what_differs_is_fetched_and_the_base_where_it_is_not_there(m, options, media, tables):
    log = play(m, link([8e4]), **options)
    assert [f.bytes for f in log.fetches if f.kind == "group"] == media
    assert [f.bytes for f in log.fetches if f.kind == "tables"] == tables


def test_the_page_of_the_base_is_fetched_first():
    """Group 66 is in airgs.json, its base on the first page."""
    group = {"table": 90, "sidecars": [30], "pictures": [[500, 300]]}
    group |= {"segments": [{"frames": 10, "bytes": [700], "psnr": [[40.0, 38.0]]}]}
    groups = [group] * 65 + [group | {"keeps": 3, "sidecars": [20], "pictures": [[70, 60]]}]
    numbers = {"frame_rate": [10, 1], "page_bytes": 4000, "header_bytes": 0, "root_bytes": 1000, "groups": groups}
    numbers |= {"qualities": ["Q0", "Q1"], "levels": [{"id": "L0", "tiers": 1, "pruned": 0.0}]}
    offers = offers_of(numbers)
    offers.first = 65
    log = simulate(offers, link([8e4]), "fixed:0", rules())
    assert [f.bytes for f in log.fetches] == [1000, 90, 4000, 90, 20 + 70 + 30 + 500 + 700]


def test_another_quality_than_the_bases_needs_the_base_in_that_quality():
    c = Offers(KEPT, 0, 1000)
    q0, q1 = (c.rungs.index((q, 0)) for q in (0, 1))
    sizes = c.offer(1).sizes(keys(2))
    assert sizes[q0] == 3000 + 200 + 2100
    assert sizes[q1] == 1000 + 200 + (1000 + 500 + 200) + 2100
    batch = c.offer(1).missing(q1, keys(2))
    assert batch.keys == (
        *("key/T0/2.bin", "key/T0/Q1/2.m4s", "key/T0/1.bin", "key/T0/Q1/1.m4s"),
        *("key/T1/2.bin", "key/T1/1.bin", "key/T1/Q1/1.m4s"),
    )
    assert c.wire_bytes([c.file_bytes(p) for p in batch.files]) == sizes[q1]


@pytest.mark.parametrize("path", ["group/1.json.gz", "key/T0/1.bin"])
def test_a_group_whose_base_cannot_be_had_is_lost_and_the_next_one_is_not(path):
    log = play(keeping(THREE), link([8e4]), faults=missing(path))
    assert [s.rung is None for s in log.shown] == [True, True, False]


FOUR = keeping(keeping(tiny_manifest(groups=(10,) * 4)), 4)  # group 3, between those that differ, stands by itself


@pytest.mark.parametrize(("m", "positions", "sizes", "decoded"), [
    (KEPT, (0, 1), [6300, 5300], ()),
    (KEPT, (1,), [9500], ()),
    (KEPT, (1,), [5300], (2,)),
    (FOUR, (1, 2, 3), [9500, 6300, 5300], ()),
    (FOUR, (2, 3), [6300, 9500], ()),  # nobody needed the base before
])  # fmt: skip
def test_the_programme_pays_for_a_base_once_however_far_back_it_was_needed(m, positions, sizes, decoded):
    """All is at its best with as many bytes for each slot after the one before, and not with one byte less."""
    c = Offers(m, 0, 1000)
    for left in (0, 1):
        ends = np.cumsum([*sizes[:-1], sizes[-1] - left])
        slots = tuple(Slot(c.offer(p), 0.0, float(end)) for p, end in zip(positions, ends, strict=True))
        best = solve_horizon(Horizon(slots, keys(*decoded)), integer=True)
        assert best is not None and (best.quality == pytest.approx(40.0)) is (left == 0)
        assert left or best.first_bytes == pytest.approx(sizes[0])


@given(st.lists(st.floats(2e4, 2e5), min_size=2, max_size=6), st.tuples(st.booleans(), st.booleans()))
@settings(max_examples=20)
def test_no_session_beats_the_bound(rates, pictures):
    m = keeping(keeping(tiny_manifest(groups=(10, 10, 10, 10)), 2, 1, pictures), 4, 1, pictures)
    for policy, loops in itertools.product(("throughput", "robust-mpc", "oracle-lp", "fixed:Q1+L1"), (1, 2)):
        log = play(m, link(rates), policy, loops=loops, replace=True, abandon=True)
        best = faces.session_bound(log)
        assert best is not None and best >= log.mean_quality - 1e-6


def test_the_bytes_of_the_next_group_are_those_that_are_then_asked_for():
    """A policy that guesses, for every rung it may take, what the next segment will cost, also in the next loop."""
    chance = np.random.default_rng(5)
    guessed = {}

    def choose(state):
        if state.position in guessed:
            assert [option.size_bytes for option in state.options] == guessed[state.position].tolist()
        option = state.options[chance.integers(len(state.options))]
        (here, _), *later = itertools.islice(state.upcoming(), 2)
        assert here is state.offer
        if later and later[0][0].starts_group:
            ((following, known),) = later
            sizes = following.bytes_after(here, known)
            guessed[state.position + 1] = sizes[option.index if len(sizes) > 1 else 0]
        return Decision(option.index, True, "any", option.size_bytes)

    for _ in range(40):
        m = tiny_manifest(groups=(10,) * 5)
        for number in range(2, 6):
            base = int(chance.integers(1, number))
            if m.groups[base - 1].keeps is None and chance.random() < 0.7:
                m = keeping(m, number, base, [(True, False), (True, True), (False, False)][chance.integers(3)])
        guessed.clear()
        log = play(m, link([8e4]), Policy("any", choose), first=int(chance.integers(3)), loops=2)
        assert log.shown and guessed
