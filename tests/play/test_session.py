"""Sessions that can be followed with a pencil, what a budget forbids, and what must hold in any of them."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests import faces
from tests.faces import BatchKind, ConfigError, Decision, Offers, Policy, SessionSettings, simulate
from tests.support.manifests import in_groups, keeping, link, missing, play, rules, tiny_manifest, with_segments
from tests.support.session_packages import offers_of

TINY = tiny_manifest()
NAMES = Offers(TINY).names
ALIKE = tiny_manifest(groups=(10, 10, 10))
UNMEASURED = tiny_manifest(psnr=None)
KEPT = keeping(tiny_manifest())
rates = st.lists(st.sampled_from([0.0, 1e4, 5e4, 2e5, 5e6]), min_size=1, max_size=12).filter(any)
POLICIES = "paper", "paper-no-cliff", "paper-literal", "throughput", "bola", "robust-mpc", "oracle-frame", "fixed:1"
BAD = None, "delta/L0/1.m4s", "keyframe/T0/Q0/2.m4s", "keyframe/T1/1.bin", "group/2.json.gz"


def segmented(m, count=3):
    """The one group of a tiny manifest in `count` segments."""
    part = m.frames // count
    levels = [replace(v, frame_bytes=v.frame_bytes[:part]) for v in m.segments[0].levels]
    return with_segments(m, [faces.Segment(i * part, (i + 1) * part, levels) for i in range(count)])


def with_core(m):
    return replace(m, levels=[*m.levels[:2], replace(m.levels[2], tiers=1)])


def by_turns(*rungs):
    """A policy that takes these rungs one after another, then the last again and again."""
    turns = itertools.chain(rungs, itertools.repeat(rungs[-1]))
    return Policy("by turns", lambda _: Decision(NAMES.index(next(turns))), needs_quality=False)


def facts(log):
    """What happened batch by batch and segment by segment, and the figures, by names that expectations use."""
    batches = {"sizes": "bytes", "requests": "request_s", "arrivals": "arrival_s", "files": "files", "waste": "wasted"}
    batches |= {"kinds": "kind", "whys": "reason"}
    told = {name: [getattr(fetch, of) for fetch in log.fetches] for name, of in batches.items()}
    segments = {"starts": "start_s", "waits": "stall_s", "ready": "ready_s", "psnr": "psnr"}
    told |= {name: [getattr(shown, of) for shown in log.shown] for name, of in segments.items()}
    told |= {"ticks": [10 * segment + frame for segment, frame in log.screen_ticks]}  # where segments have ten frames
    told |= {"rungs shown": [None if shown.rung is None else NAMES[shown.rung] for shown in log.shown]}
    return told | log.metrics.as_dict()


EVEN, HALF, FAST = link([8e4]), link([4e4]), link([8e6])
# Two groups with these rows in their two tiers; the last level needs the first tier alone, the others both.
TIERED = [
    replace(group, tiers=[replace(tier, count=n) for tier, n in zip(group.tiers, rows, strict=True)])
    for group, rows in zip(TINY.groups, ((10, 30), (20, 60)), strict=True)
]
TIERED = with_core(replace(TINY, groups=in_groups(TIERED)))
SEGMENTED, COARSE_THEN_FINE = segmented(tiny_manifest(groups=(30,))), ("Q1+L2", "Q1+L2", "Q0+L2")
HAND = {  # name -> package, link, policy or rungs by turns, rules, and what comes of it
    # 10,000 B/s: 1000 B of airgs.json, then for each group 100 of table, and 4000 keyframe + 2100 delta + 200 sidecars.
    "a session": (TINY, EVEN, "fixed:0", {}, {"kinds": ["tables", "tables", "group", "tables", "group"],
        "sizes": [1000, 100, 6300, 100, 6300], "arrivals": [0.1, 0.11, 0.74, 0.75, 1.38], "starts": [0.74, 1.74],
        "startup_s": 0.74, "startup_requests": 1 + 1 + 5, "startup_table_bytes": 1100, "stalls": 0, "stall_s": 0,
        "switches": 0, "frames": 20, "bytes": {"manifests": 1200, "keyframe": 8000, "sidecars": 400, "delta": 4200},
        "wire_bytes": 13_800, "psnr_mean": 40.0, "delta_e_mean": 0.5,
        "seek_s": 0.01 + 0.63, "bits_per_gaussian": 8 * 13_800 / (20 * 20)}),
    # 20 frames, and 0.28 s of waiting at 10 fps with the picture that stood.
    "half the rate": (tiny_manifest(psnr=[[40.0, 0.0]] * 3), HALF, "fixed:0", {}, {
        "arrivals": [0.2, 0.22, 1.48, 1.5, 2.76], "waits": [0, 0.28], "ticks": [*range(10), 9, 9, 9, *range(10, 20)],
        "stall_ratio": 0.28 / 2.28, "qoe": 40 - 200 * 0.28 / 2}),
    # A table is one file; a group has 2 tiers of 2 files and a delta.
    "headers, round trips and decoding": (TINY, link([8e4], rtt=0.1), "fixed:0",
        {"decode_frame_s": 0.05, "headers": 100}, {"arrivals": [0.21, 0.33, 1.11, 1.23, 2.01], "starts": [1.16, 2.16],
        "seek_s": 0.1 + 0.02 + 0.1 + 0.68 + 0.05}),
    "seeks after the end of the trace do not count": (
        TINY, link([8e4], [0], 1.385, end="error"), "fixed:0", {}, {"starts": [0.74, 1.74], "seek_s": 0.64}),
    "an empty level costs its keyframes": (tiny_manifest(delta_bytes=(2000, 1000, 0)), EVEN, "fixed:2", {},
        {"sizes": [1000, 100, 4200, 100, 4200], "bytes": {"manifests": 1200, "keyframe": 8000, "sidecars": 400}}),
    # The last level does with T0; rising in the middle of a group brings T1 along, once.
    "one tier": (with_core(segmented(tiny_manifest(groups=(30,), psnr=None))), EVEN, "fixed:2", {},
        {"bytes": {"manifests": 1100, "keyframe": 3000, "sidecars": 100, "delta": 1800}}),
    "two tiers": (with_core(segmented(tiny_manifest(groups=(30,), psnr=None))), EVEN, ("Q0+L2", "Q0+L0"), {},
        {"bytes": {"manifests": 1100, "keyframe": 4000, "sidecars": 200, "delta": 600 + 4200}}),
    "a loop": (TINY, FAST, "fixed:1", {}, {
        "bytes": {"manifests": 1200, "keyframe": 8000, "sidecars": 400, "delta": 2200}}),
    "loops fetch keyframes and deltas again but not tables": (TINY, FAST, "fixed:1", {"loops": 2}, {
        "bytes": {"manifests": 1200, "keyframe": 16_000, "sidecars": 800, "delta": 4400}}),
    "half a minute by default": (TINY, FAST, "fixed:1", {"loops": None}, {"played_s": 30.0}),
    # 0.63 s of download each and 0.01 of tables: the second segment is there at 1.38 s.
    "playing begins when enough is at hand": (
        TINY, EVEN, "fixed:0", {"startup_s": 1.5}, {"starts": [1.38, 2.38], "waits": [0, 0]}),
    "half the rate, twice": (TINY, HALF, "fixed:0", {"loops": 2}, {
        "ready": [1.48, 2.76, 4.02, 5.28], "starts": [1.48, 2.76, 4.02, 5.28], "waits": [0, 0.28, 0.26, 0.26]}),
    "it goes on when enough is at hand again": (TINY, HALF, "fixed:0", {"loops": 2, "resume_s": 1.5}, {
        "ready": [1.48, 2.76, 4.02, 5.28], "starts": [1.48, 4.02, 5.02, 6.02], "waits": [0, 1.54, 0, 0]}),
    # Two segments are all that it may hold: they are there at 2.76 s, and the next two, of which one is asked for when
    # there is room at 3.76 s, at 6.28 s.
    "a full buffer need not wait for more": (TINY, HALF, "fixed:0",
        {"loops": 2, "resume_s": 9.0, "startup_s": 9.0, "buffer_s": 2.0}, {"starts": [2.76, 3.76, 6.28, 7.28]}),
    # A round trip is paid for airgs.json, for a table and for the first batch; the table of the third group comes with
    # the second batch, so that nothing is waited for.
    "asking ahead hides the round trip": (ALIKE, link([8e4], rtt=0.1), "fixed:0", {"pipelined": True}, {
        "arrivals": [0.2, 0.31, 1.04, 1.15, 1.79, 2.42], "requests": [0, 0.2, 0.31, 1.04, 1.05, 1.69],
        "files": [1, 1, 5, 1, 6, 5]}),
    # Both segments come in the smallest rung. Until the second begins, its delta of 600 B is replaced, and then its
    # keyframes, which stay decoded.
    "replacements": (TINY, EVEN, ("Q1+L2",), {"replace": True}, {
        "kinds": ["tables", "tables", "group", "tables", "group", "replacement", "replacement"],
        "sizes": [1000, 100, 2300, 100, 2300, 1100, 4200], "arrivals": [0.1, 0.11, 0.34, 0.35, 0.58, 0.69, 1.11],
        "rungs shown": ["Q1+L2", "Q0+L1"], "psnr": [32.0, 38.0], "waste": [0, 0, 0, 0, 600, 0, 0],
        "replaced": 2, "wasted": 600 / 11_100, "change_db": 6.0}),
    # The link gives out under a replacement, which is late by 0.16 s and served nothing.
    "a replacement that comes too late": (TINY, link([8e4, 8e3, 8e4], [0, 0.58, 2], 100), ("Q1+L2",), {"replace": True},
        {"arrivals": [0.1, 0.11, 0.34, 0.35, 0.58, 1.68], "rungs shown": ["Q1+L2"] * 2, "starts": [0.34, 1.34],
        "waste": [0, 0, 0, 0, 0, 1100], "replaced": 1}),
    # There at 1.38 s, it would be decoded at 1.48 s, and the segment begins at 1.44 s.
    "a replacement that is decoded too late": (
        TINY, link([8e4, 1.1e4], [0, 0.58], 100), ("Q1+L2",), {"replace": True, "decode_frame_s": 0.1},
        {"rungs shown": ["Q1+L2"] * 2, "starts": [0.44, 1.44], "waste": [0, 0, 0, 0, 0, 1100]}),
    # At 2.08 s a first byte could be there at 2.38 s, and the segment begins at 2.24 s.
    "no replacement within a round trip": (
        TINY, link([8e4], rtt=0.3), ("Q1+L2",), {"replace": True}, {"starts": [1.24, 2.24], "replaced": 0}),
    # Of 6300 B 3385 have passed at the first look, half a second after the first byte; the files share the link, so
    # that two sidecars and the keyframes of T1 are whole, and stay. What is left is more than all of the smallest rung.
    "a download that would come too late is given up": (
        TINY, link([8e4, 4e3, 8e4], [0, 0.44, 1], 100), ("Q0+L0", "Q1+L2"), {"abandon": True},
        {"sizes": [1000, 100, 3385, 2300, 100, 2300], "arrivals": [0.1, 0.11, 0.61, 1.2105, 1.2205, 1.4505],
         "waste": [0, 0, 3385 - 200 - 1000, 0, 0, 0], "abandoned": 1, "rungs shown": ["Q1+L2"] * 2,
         "bytes": {"manifests": 1200, "keyframe": 1000 + 3000, "sidecars": 200 + 400, "delta": 1200},
         "startup_requests": 1 + 1 + 3 + 5}),
    "a patient player waits longer for it": (TINY, link([8e4, 4e3, 8e4], [0, 0.44, 1], 100), ("Q0+L0", "Q1+L2"), {},
        {"sizes": [1000, 100, 6300, 100, 2300], "startup_s": 1.272, "abandoned": 0, "waste": [0] * 5}),
    # The third segment, there at 0.88 s, brings the finest keyframes, also for the second, which begins at 1.34 s: but
    # not on half the link with 0.1 s to decode, at 1.86 s for 1.78 s, nor for another group or the loop before.
    "better keyframes serve what is buffered of their group": (
        SEGMENTED, EVEN, COARSE_THEN_FINE, {}, {"rungs shown": ["Q1+L2", "Q0+L2", "Q0+L2"]}),
    "where they are decoded in time": (
        SEGMENTED, HALF, COARSE_THEN_FINE, {"decode_frame_s": 0.1}, {"rungs shown": [*COARSE_THEN_FINE]}),
    "of no other group": (ALIKE, EVEN, COARSE_THEN_FINE, {}, {"rungs shown": [*COARSE_THEN_FINE]}),
    "of no other loop": (SEGMENTED, EVEN, ("Q1+L2", *COARSE_THEN_FINE), {"loops": 2},
        {"rungs shown": ["Q1+L2"] * 3 + ["Q0+L2"] * 3}),
    # Six segments in one group: the first comes with coarse keyframes, of 1500 B, the second with fine ones, of 4000 B.
    "a better keyframe serves the rest of its group": (segmented(tiny_manifest(groups=(60,)), 6),
        link([2.4e4, 8e6], [0, 1.2], 1000), "robust-mpc", {}, {"rungs shown": ["Q1+L1", "Q0+L1"] + ["Q0+L0"] * 4,
        "bytes": {"manifests": 1100, "keyframe": 1500 + 4000, "sidecars": 400, "delta": 10_600},
        "kinds": ["tables", "tables", "group", "delta", "group", "delta", "delta", "delta"]}),
    # The second group keeps rows: of 3000 + 1000 B of pictures it has the first tier's alone, with both sidecars.
    "kept rows are not fetched again": (KEPT, EVEN, "fixed:0", {}, {"sizes": [1000, 100, 6300, 100, 5300]}),
    "but in each loop": (KEPT, EVEN, "fixed:0", {"loops": 2}, {"sizes": [1000, 100, 6300, 100, 5300, 6300, 5300]}),
    # Who joins there needs airgs.json, the table of the group, then that of its base, and the keyframes of that.
    "who joins fetches the base": (KEPT, EVEN, "fixed:0", {"first": 1}, {"sizes": [1000, 100, 100, 9500]}),
    "once for two that differ from it": (
        keeping(keeping(ALIKE), 3), EVEN, "fixed:0", {"first": 1}, {"sizes": [1000, 100, 100, 9500, 100, 5300]}),
    **{f"without {path} of its base a group is lost, and the next one is not": (
        keeping(ALIKE), EVEN, "fixed:0", {"faults": missing(path)}, {"rungs shown": [None, None, "Q0+L0"]},
    ) for path in ("group/1.json.gz", "keyframe/T0/1.bin")},
    "a group without its keyframe is lost, and the last picture stands for its time": (
        TINY, FAST, "paper-no-cliff", {"faults": missing("keyframe/T0/1.bin")},
        {"rungs shown": [None, "Q0+L0"], "lost_frames": 10, "psnr_mean": 40.0, "waits": [0, 0],
        "whys": ["tables", "tables", "6300 B fit 900000 B", "tables", "6300 B fit 900000 B"]}),
    "nothing fits from the first choice on": (TINY, link([2e4]), "paper-no-cliff", {}, {
        "rungs shown": ["Q1+L2"] * 2, "whys": ["tables", *["tables", "nothing fits 2250 B, taking the smallest"] * 2]}),
    "all is lost": (TINY, FAST, "paper-no-cliff", {"faults": missing(*TINY.group_files(0), *TINY.group_files(1))},
        {"rungs shown": [None, None], "psnr_mean": None, "lost_frames": 20, "rungs": {"lost": 2}}),
    **{f"a missing table costs {policy} its group": (ALIKE, FAST, policy, {"faults": missing("group/2.json.gz")},
        {"rungs shown": ["Q0+L0", None, "Q0+L0"], "lost_frames": 10}) for policy in ("paper-no-cliff", "robust-mpc")},
    "a missing delta costs its level": (TINY, FAST, "paper-no-cliff", {"faults": missing("delta/L0/2.m4s")},
        {"rungs shown": ["Q0+L0", "Q0+L1"], "lost_frames": 0, "files": [1, 1, 5, 1, 5, 1],
        "bytes": {"manifests": 1200, "keyframe": 8000, "sidecars": 400, "delta": 2100 + 1100}}),
    "no quality": (UNMEASURED, FAST, "fixed:0", {}, {"psnr_mean": None, "delta_e_mean": None, "qoe": None}),
}  # fmt: skip


@pytest.mark.parametrize("name", HAND)
def test_sessions_by_hand(name):
    m, over, policy, options, expected = HAND[name]
    got = facts(play(m, over, policy if isinstance(policy, str) else by_turns(*policy), **options))
    for what, value in expected.items():
        assert got[what] == pytest.approx(value), what


@pytest.mark.parametrize("options", [{}, {"psnr": None}, {"delta_bytes": (2000, 1000, 0)}], ids=str)
def test_the_test_manifest_is_a_manifest(options):
    m = tiny_manifest(**options)
    faces.check_root(faces.root_of(m))
    for number, group in enumerate(m.groups):
        faces.check_group(m, m.groups.places.entry(number), group, "group")
    first, second = keeping(m).groups
    faces.check_group(m, m.groups.places.entry(1), second, "group")
    faces.check_base(second, first, "group")
    with pytest.raises(faces.FormatError, match="centres"):
        faces.check_group(m, m.groups.places.entry(1), replace(second, base=None), "group")


@pytest.mark.parametrize("buffer_s", [3.0, 2.5])  # whole segments of a second, and half of one
def test_the_buffer_holds_requests_back_and_a_full_one_lets_nobody_ask_before_there_is_room(buffer_s):
    log = play(TINY, link([8e9]), loops=20, buffer_s=buffer_s)
    begin = log.shown[0].start_s
    for i, fetch in enumerate(f for f in log.fetches if f.kind == "group"):
        assert fetch.request_s >= begin + i + 1 - buffer_s - 1e-9
    assert log.fetches[-1].request_s == pytest.approx(begin + 40 - buffer_s) and log.metrics.stalls == 0
    full = play(TINY, link([8e9], rtt=0.1), pipelined=True, loops=20, buffer_s=buffer_s)
    for i, fetch in enumerate(f for f in full.fetches if f.kind != "tables"):
        assert i < 4 or fetch.arrival_s >= full.shown[0].start_s + i + 1 - buffer_s + 0.1 - 1e-6


@pytest.mark.parametrize(("m", "options", "words"), [
    *((TINY, {"buffer_s": value}, "buffer") for value in (0.0, float("nan"))),
    *((TINY, {"decode_frame_s": value}, "decoding") for value in (-1.0, float("inf"))),
    *((TINY, {"loops": value}, "loops") for value in (0, -1)),
    *((TINY, {"policy": text}, "expected paper") for text in ("", "paper:1", "best", "fixed", "fixed:")),
    *((TINY, {"policy": f"fixed:{rung}"}, "expected paper") for rung in (3, -1, 1.5, "Q2+L0")),
    (TINY, {"startup_s": -1.0}, "start-up"), (TINY, {"resume_s": float("inf")}, "resume"),
    (TINY, {"budget": 0}, "budget: expected at least 1, got 0"),
    (UNMEASURED, {"policy": "paper-no-cliff"}, "no measured quality"),
    *((TINY, {"rtt": rtt}, "round trip") for rtt in (-0.1, float("nan"), float("inf"))),
])  # fmt: skip
def test_sessions_that_cannot_be(m, options, words):
    with pytest.raises(ConfigError, match=words):
        play(m, link([8e6], rtt=options.pop("rtt", 0.0)), **options)


def test_a_replacement_that_cannot_be_had_is_asked_for_once():
    options = {"buffer_s": 4.0, "loops": 4, "replace": True, "faults": missing("keyframe/T0/Q0/1.m4s")}
    log = play(TINY, link([3e4, 8e6], [0, 2], 1000), "paper-no-cliff", **options)
    assert [f.rung for f in log.fetches if f.kind is BatchKind.REPLACEMENT and f.position == 2] == [0, 3]


def test_what_was_lost_is_told_once_and_a_corrupt_file_travels_before_it_is_found_wrong():
    group, path, keyframe = "group/2.json.gz", "delta/L0/2.m4s", "keyframe/T0/1.bin"
    broken = {path: faces.FormatError("hash_mismatch", path, "the SHA-256 differs")}
    absent, corrupt = (play(TINY, link([8e6]), "paper-no-cliff", faults=f) for f in (missing(path), broken))
    assert corrupt.fetches[4].bytes == absent.fetches[4].bytes + 2100
    assert corrupt.fetches[4].wasted > absent.fetches[4].wasted
    table, delta, lost = (play(ALIKE, link([8e6]), "robust-mpc", faults=missing(p)) for p in (group, path, keyframe))
    assert sum(group in line for line in table.lost) == 1 and path in delta.lost[0]
    assert keyframe in lost.lost[0] and "frames 0-9" in lost.lost[-1] and "lost" in faces.format_metrics(lost)
    assert faces.session_bound(lost) is None


def test_the_page_of_the_base_is_fetched_first():
    """Group 66 is in airgs.json, its base on the first page."""
    group = {"table": 90, "sidecars": [30], "pictures": [[500, 300]]}
    group |= {"segments": [{"frames": 10, "bytes": [700], "psnr": [[40.0, 38.0]]}]}
    groups = [group] * 65 + [group | {"base": 3, "sidecars": [20], "pictures": [[70, 60]]}]
    numbers = {"frame_rate": [10, 1], "page_bytes": 4000, "header_bytes": 0, "root_bytes": 1000, "groups": groups}
    numbers |= {"qualities": ["Q0", "Q1"], "levels": [{"id": "L0", "tiers": 1, "pruned": 0.0}]}
    offers = offers_of(numbers)
    offers.first = 65
    log = simulate(offers, link([8e4]), "fixed:0", rules())
    assert [f.bytes for f in log.fetches] == [1000, 90, 4000, 90, 20 + 70 + 30 + 500 + 700]


def test_the_bytes_of_the_next_group_are_those_that_are_then_asked_for():
    """A policy that guesses, for every rung it may take, what the next segment will cost, also in the next loop."""
    chance = np.random.default_rng(5)
    guessed = {}

    def choose(delta):
        if delta.position in guessed:
            assert [option.size_bytes for option in delta.options] == guessed[delta.position].tolist()
        option = delta.options[chance.integers(len(delta.options))]
        (here, _), *later = itertools.islice(delta.upcoming(), 2)
        assert here is delta.offer
        if later and later[0][0].starts_group:
            ((following, known),) = later
            sizes = following.bytes_after(here, known)
            guessed[delta.position + 1] = sizes[option.index if len(sizes) > 1 else 0]
        return Decision(option.index, True, "any", option.size_bytes)

    for _ in range(40):
        m = tiny_manifest(groups=(10,) * 5)
        for number in range(2, 6):
            base = int(chance.integers(1, number))
            if m.groups[base - 1].base is None and chance.random() < 0.7:
                m = keeping(m, number, base, [(True, False), (True, True), (False, False)][chance.integers(3)])
        guessed.clear()
        log = play(m, link([8e4]), Policy("any", choose), first=int(chance.integers(3)), loops=2)
        assert log.shown and guessed


@settings(max_examples=120)
@given(
    rates=rates, policy=st.sampled_from(POLICIES), buffer_s=st.sampled_from([0.5, 2.0, 10.0]),
    extras=st.tuples(st.booleans(), st.booleans(), st.sampled_from([0.0, 0.5, 2.5])),
    split=st.booleans(), ahead=st.booleans(), bad=st.sampled_from(BAD),
)  # fmt: skip
def test_any_session_is_causal_deterministic_and_accounted_for(rates, policy, buffer_s, extras, split, ahead, bad):
    m = SEGMENTED if split else TINY
    faults = missing(bad) if bad in list(m.files()) else {}
    again, give_up, wait = extras
    options = SessionSettings(buffer_s, wait, wait, 0.01, again, give_up, ahead, loops=3)
    over = link(rates, rtt=0.08)
    a, b = (simulate(Offers(m, root_bytes=1000), over, policy, options, faults) for _ in range(2))
    assert (a.fetches, a.shown, a.metrics) == (b.fetches, b.shown, b.metrics)
    for first, second in itertools.pairwise(a.fetches):
        assert first.request_s <= first.arrival_s <= second.request_s + over.rtt_s * ahead + 1e-9
        assert first.arrival_s <= second.arrival_s
    for s in a.shown:
        assert s.ready_s <= s.start_s + 1e-9
    ends = [s.start_s + s.frames / 10 for s in a.shown]
    for end, later in zip(ends, a.shown[1:], strict=False):
        assert later.stall_s >= 0 and later.start_s == pytest.approx(end + later.stall_s)
    quality = np.array([s.psnr for s in a.shown if s.psnr is not None])
    if len(quality):
        shown = (quality.sum() - np.abs(np.diff(quality)).sum()) / len(quality)
        assert a.metrics.qoe == pytest.approx(shown - 200 * a.metrics.stall_s / a.metrics.played_s)
    assert sum(a.bytes_by_kind.values()) <= a.metrics.wire_bytes
    assert all(0 <= f.wasted <= f.bytes for f in a.fetches)
    used = over.bytes_between(0.0, a.fetches[-1].arrival_s)
    assert a.metrics.wire_bytes <= used * (1 + 1e-9) + len(a.fetches)  # nothing travels that the trace lacks
    bound = faces.session_bound(a)
    if bound is not None:
        assert bound >= a.mean_quality - 1e-6


def test_figures_of_a_session_are_what_its_batches_and_segments_say():
    """Two segments, of 5 and 10 frames, whose batches take 0.76 and 2.2156 s of a link that is never idle."""
    log = play(TINY, link([40_000, 8_000, 3_000, 90_000]), "throughput")
    fetches = list(log.fetches)
    fetches[2] = replace(fetches[2], retries=2, wasted=100)
    shown = [replace(log.shown[0], frames=5), replace(log.shown[1], rung=0, psnr=40.0)]
    log = replace(log, fetches=fetches, shown=shown, bytes_by_kind={faces.FileKind.KEYFRAME: 3000})
    m = log.metrics
    assert (m.bytes_per_frame, m.wasted) == (200.0, 100 / sum(f.bytes for f in fetches))
    assert (m.retries, m.replaced) == (2, 0)
    assert m.rungs == {"Q1+L0": 1, "Q0+L0": 1} and (m.switches, m.lost_frames, m.stalls) == (1, 0, 1)
    assert m.change_db == pytest.approx(4.0)
    assert m.qoe == pytest.approx((36 + 40 - 4) / 2 - 200 * shown[1].stall_s / 1.5)
    assert m.startup_requests == 1 + 1 + 5 + 2 and m.startup_bytes == 1000 + 100 + 3800
    assert m.utilisation == pytest.approx(1.0)
    lost = [shown[0], replace(shown[1], rung=None, psnr=None, stall_s=1e-9)]  # s, which rounding may make
    m = replace(log, link=None, shown=lost).metrics
    assert m.rungs == {"Q1+L0": 1, "lost": 1} and (m.lost_frames, m.stalls, m.change_db) == (10, 0, 0.0)
    assert m.utilisation is None and m.seek_s is None


@pytest.mark.parametrize("policy", ["fixed:0", *faces.NAMES])
@pytest.mark.parametrize(("budget", "most", "levels", "words"), [
    (20, 20, {2}, "of a budget of 20"),
    (79, 40, {0, 1, 2}, "of a budget of 79"),  # enough for both tiers of the first group, but for one of the second
    (80, 80, {0, 1, 2}, "of a budget of 80"),
    (None, 80, {0, 1, 2}, "at most 80\n"),
])  # fmt: skip
def test_no_policy_shows_or_fetches_more_than_the_budget(policy, budget, most, levels, words):
    log = play(TIERED, link([9e6]), policy, budget=budget, loops=2, pipelined=True, replace=True, abandon=True)
    assert log.metrics.gaussians == most
    assert all(log.offers.offer(s.segment).rungs[s.rung].gaussians <= most for s in log.shown)
    assert {log.offers.rungs[fetch.rung][1] for fetch in log.fetches if fetch.kind != "tables"} <= levels
    assert not log.lost and words in faces.format_metrics(log)


def test_looking_ahead_counts_what_the_budget_forbids():
    """No path leads through a rung over the budget, and the bound does not show one either."""
    first, second = (Offers(TIERED, 0, 1000).offer(segment, budget=79) for segment in (0, 1))
    allowed = np.array([rung.allowed for rung in second.rungs])
    assert all(rung.allowed for rung in first.rungs) and allowed.tolist() == [False, False, True] * 2
    forbidden = second.bytes_after(first, faces.NONE)[:, ~allowed]  # more bytes than any link carries
    assert forbidden.min() >= 1 << 50 > max(first.sizes(faces.NONE))
    assert [p.index for p in second.options(faces.NONE)] == [2, 5]
    held, free = (play(TIERED, link([9e6]), budget=budget) for budget in (79, None))
    assert faces.session_bound(held) == pytest.approx((40 + 34) / 2) and faces.session_bound(free) == pytest.approx(40)
    assert held.mean_quality <= faces.session_bound(held) + 1e-6


def test_a_budget_that_no_rung_meets():
    """Of tables that are all known none is shown in part; else the first group decides, and a later one is lost."""
    with pytest.raises(ConfigError, match="budget: expected 20 Gaussians or more, got 19"):
        play(TIERED, link([9e6]), "robust-mpc", budget=19)
    c = Offers(TIERED, 0, 1000)
    policy, downloader = faces.make_policy("fixed:0", c), faces.SimulatedDownloader(link([9e6]), c, {})
    seen = list(faces.run(c, downloader, policy, SessionSettings(budget=15, loops=1)))
    assert [e.rung is None for e in seen if isinstance(e, faces.Shown)] == [False, True]
    assert [e.position for e in seen if isinstance(e, faces.Lost)] == [1]
    with pytest.raises(ConfigError, match="expected 10 Gaussians or more"):
        list(faces.run(c, downloader, policy, SessionSettings(budget=9, loops=1)))
