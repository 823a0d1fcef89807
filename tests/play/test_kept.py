"""Sessions over packages of keys that are differences: what must be fetched for that, and no more."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from airgs_codec.package.references import check_base
from tests.faces import (
    NO_FILE,
    Decision,
    FormatError,
    Horizon,
    Offers,
    Policy,
    SimulatedDownloader,
    Slot,
    check_group,
    run,
    session_bound,
    simulate,
    solve_horizon,
)
from tests.play.test_session import link, rules
from tests.support.manifests import in_groups, keys, missing, tiny_manifest
from tests.support.session_packages import offers_of

RULES = rules()


def keeping(m, number=2, of=1, pictures=(True, False)):
    """The manifest with a group whose keys are differences; a tier of which nothing differs has no pictures."""
    groups = list(m.groups)
    group = groups[number - 1]
    tiers = [
        replace(
            tier,
            qualities=[_difference(atlas, there) for atlas in tier.qualities],
            pictures=tier.pictures if there else [NO_FILE] * len(tier.pictures),
        )
        for tier, there in zip(group.tiers, pictures, strict=True)
    ]
    groups[number - 1] = replace(group, tiers=tiers, keeps=of)
    return replace(m, groups=in_groups(groups))


def _difference(atlas, there):
    centres, errors = [0, 0, 0, *atlas.centres], [0.0, *atlas.max_error]
    rows, planes = (atlas.rows, atlas.planes) if there else (0, [])
    return replace(atlas, rows=rows, planes=planes, centres=centres, max_error=errors)


def play(m, policy="fixed:0", over=None, faults=None, **options):
    return simulate(Offers(m, 0, 1000), over or link([8e4]), policy, replace(RULES, **options), faults)


def test_the_manifest_is_one():
    m = keeping(tiny_manifest())
    check_group(m, m.groups.places.entry(1), m.groups[1], "group")
    check_base(m.groups[1], m.groups[0], "group")
    with pytest.raises(FormatError, match="centres"):
        check_group(m, m.groups.places.entry(1), replace(m.groups[1], keeps=None), "group")


def test_who_has_the_base_fetches_only_what_is_new():
    """Of 3000 + 1000 B of pictures the second group has the first tier's alone, with both sidecars."""
    log = play(keeping(tiny_manifest()))
    assert [f.bytes for f in log.fetches if f.kind == "group"] == [6300, 3000 + 200 + 2100]


def test_who_joins_at_a_group_fetches_the_table_and_keys_of_its_base():
    offers = Offers(keeping(tiny_manifest()), 0, 1000, first=1)
    log = simulate(offers, link([8e4]), "fixed:0", RULES)
    tables = [f.bytes for f in log.fetches if f.kind == "tables"]
    assert tables == [1000, 100, 100]  # airgs.json, the table of the group, then that of its base
    assert [f.bytes for f in log.fetches if f.kind == "group"] == [3000 + 200 + 4200 + 2100]


def test_the_page_of_the_base_is_fetched_first():
    """Group 66 is in airgs.json, its base on the first page."""
    group = {"table": 90, "sidecars": [30], "pictures": [[500, 300]]}
    group |= {"segments": [{"frames": 10, "bytes": [700], "psnr": [[40.0, 38.0]]}]}
    groups = [group] * 65 + [group | {"keeps": 3, "sidecars": [20], "pictures": [[70, 60]]}]
    numbers = {"frame_rate": [10, 1], "page_bytes": 4000, "header_bytes": 0, "root_bytes": 1000, "groups": groups}
    numbers |= {"qualities": ["Q0", "Q1"], "levels": [{"id": "L0", "tiers": 1, "pruned": 0.0}]}
    offers = offers_of(numbers)
    offers.first = 65
    log = simulate(offers, link([8e4]), "fixed:0", RULES)
    assert [f.bytes for f in log.fetches] == [1000, 90, 4000, 90, 20 + 70 + 30 + 500 + 700]


def test_another_quality_than_the_bases_needs_the_base_in_that_quality():
    m = keeping(tiny_manifest())
    c = Offers(m, 0, 1000)
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


def test_each_loop_fetches_the_base_again():
    log = play(keeping(tiny_manifest()), loops=2)
    assert [f.bytes for f in log.fetches if f.kind == "group"] == [6300, 5300, 6300, 5300]


def test_two_groups_after_each_other_differ_from_one():
    m = keeping(keeping(tiny_manifest(groups=(10, 10, 10))), 3)
    offers = Offers(m, 0, 1000, first=1)
    log = simulate(offers, link([8e4]), "fixed:0", RULES)
    assert [f.bytes for f in log.fetches if f.kind == "group"] == [3000 + 200 + 4200 + 2100, 5300]


@pytest.mark.parametrize("path", ["group/1.json.gz", "key/T0/1.bin"])
def test_a_group_whose_base_cannot_be_had_is_lost_and_the_next_one_is_not(path):
    m = keeping(tiny_manifest(groups=(10, 10, 10)))
    log = play(m, faults=missing(path))
    assert [s.rung is None for s in log.shown] == [True, True, False]


def test_the_programme_pays_for_a_base_once():
    c = Offers(keeping(tiny_manifest()), 0, 1000)
    both = (Slot(c.offer(0), 0.0, 6300.0), Slot(c.offer(1), 0.0, 6300.0 + 5300))
    best = solve_horizon(Horizon(both), integer=True)
    assert best is not None and best.quality == pytest.approx(40.0)
    alone = solve_horizon(Horizon((replace(both[1], capacity=9500.0),)), integer=True)
    assert alone is not None and alone.first_bytes == pytest.approx(9500)
    held = solve_horizon(Horizon((replace(both[1], capacity=5300.0),), keys(2)), integer=True)
    assert held is not None and held.quality == pytest.approx(40.0)


def test_a_base_is_paid_once_however_far_back_it_was_needed():
    """Groups 2 and 4 differ from group 1, which is not shown; group 3, between them, stands by itself."""
    c = Offers(keeping(keeping(tiny_manifest(groups=(10,) * 4)), 4, 1), 0, 1000)
    ends = np.cumsum([9500.0, 6300.0, 5300.0])
    slots = tuple(Slot(c.offer(position), 0.0, float(end)) for position, end in zip((1, 2, 3), ends, strict=True))
    best = solve_horizon(Horizon(slots), integer=True)
    assert best is not None and best.quality == pytest.approx(40.0)
    short = solve_horizon(Horizon((*slots[:2], replace(slots[2], capacity=ends[2] - 1))), integer=True)
    assert short is not None and short.quality < 40
    for end, whole in ((6300.0 + 9500.0, True), (6300.0 + 9499.0, False)):  # nobody needed it before
        alone = solve_horizon(
            Horizon((replace(slots[1], capacity=6300.0), replace(slots[2], capacity=end))), integer=True
        )
        assert alone is not None and (alone.quality == pytest.approx(40.0)) is whole


@given(st.lists(st.floats(2e4, 2e5), min_size=2, max_size=6), st.tuples(st.booleans(), st.booleans()))
@settings(max_examples=20)
def test_no_session_beats_the_bound(rates, pictures):
    m = keeping(keeping(tiny_manifest(groups=(10, 10, 10, 10)), 2, 1, pictures), 4, 1, pictures)
    for policy, loops in itertools.product(("throughput", "robust-mpc", "oracle-lp", "fixed:Q1+L1"), (1, 2)):
        log = play(m, policy, link(rates), loops=loops, replace=True, abandon=True)
        best = session_bound(log)
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
        c = Offers(m, 0, 1000, first=int(chance.integers(3)))
        downloader = SimulatedDownloader(link([8e4]), c)
        assert list(run(c, downloader, Policy("any", choose), replace(RULES, loops=2))) and guessed
