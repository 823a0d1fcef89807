"""Small manifests with known sizes, and sessions over them, for tests of the player."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import accumulate
from typing import Any

import numpy as np

from airgs_codec.package import tables as mf
from tests.faces import FormatError, Groups, Link, Manifest, Offers, SessionLog, SessionSettings, Trace, simulate
from tests.support.regions import region

Floats = Sequence[float]
HASH = mf.digest(b"")
BARE = {"startup_s": 0.0, "resume_s": 0.0, "decode_frame_s": 0.0, "loops": 1}
BARE |= {"pipelined": False, "replace": False, "abandon": False}


def rules(**options: Any) -> SessionSettings:
    """Rules under which a session can be followed with a pencil, but for `options`."""
    return SessionSettings(**(BARE | options))


def link(rates: Floats, starts: Floats = (), duration: float = 0.0, rtt: float = 0.0, end: str = "loop") -> Link:
    """A link of these bit/s, each from its start on, or for a second."""
    starts = starts or range(len(rates))
    last = float(duration or starts[-1] + 1)
    return Link(Trace("t", np.array(starts, float), np.array(rates, float), last, end=end), rtt)


def play(
    m: Manifest, over: Link, policy: Any = "fixed:0", headers: int = 0, faults: Any = (), first: int = 0, **options: Any
) -> SessionLog:
    """A session with 1000 bytes of airgs.json and the bare rules but for `options`."""
    offers = Offers(m, headers, 1000)
    offers.first = first
    return simulate(offers, over, policy, rules(**options), dict(faults))


def missing(*paths: str) -> dict[str, FormatError]:
    """Faults of a package without these files, as `find_faults` gives them."""
    return {path: FormatError("missing_file", path, "expected a file, got nothing") for path in paths}


def in_groups(groups: Sequence[mf.Group], table_bytes: int = 100) -> Groups:
    """Groups in memory, at most 63, whose tables are said to have so many bytes."""
    counts = [group.stop - group.start for group in groups], [len(group.segments) for group in groups]
    spans = mf.Spans(*counts, [table_bytes] * len(groups), HASH * len(groups))
    return Groups([spans], no_page, lambda number, _: groups[number])


def no_page(path: str, _: object) -> mf.Spans:
    raise AssertionError(f"{path}: nothing leads to it")


def with_segments(m: Manifest, segments: Sequence[mf.Segment]) -> Manifest:
    """A manifest whose groups have these segments, each in the group that holds its frames."""
    groups = [
        replace(group, segments=[s for s in segments if group.start <= s.start < group.stop]) for group in m.groups
    ]
    return replace(m, groups=in_groups(groups))


def keyframes(*tiers: int, group: int = 0) -> frozenset[tuple[int, int, int]]:
    """Keyframes (group, keyframe quality, tier): so many tiers of each keyframe quality, from the first on."""
    return frozenset((group, quality, tier) for quality, count in enumerate(tiers) for tier in range(count))


def tiny_manifest(
    *, groups: Sequence[int] = (10, 10), fps: tuple[int, int] = (10, 1), sidecar_bytes: int = 100,
    keyframe_bytes: Sequence[Sequence[int]] = ((3000, 1000), (1000, 500)), table_bytes: int = 100,
    delta_bytes: Sequence[int] = (2000, 1000, 500),
    psnr: Sequence[Floats] | None = ((40.0, 36.0), (38.0, 35.0), (34.0, 32.0)),
) -> Manifest:  # fmt: skip
    """One segment a group of `groups` frames; keyframe_bytes[tier][quality], delta_bytes[level], psnr[level][quality].

    A delta segment has `sidecar_bytes` beside its pictures. A level of 0 bytes has nothing to fetch.
    """
    tiers, qualities, levels = len(keyframe_bytes), len(keyframe_bytes[0]), len(delta_bytes)
    atlas, keyframe = (mf.Atlas(10, [0] * n, [0], 16, 1, 64, 64, [0.1] * errors) for n, errors in ((13, 5), (10, 4)))

    def level(j: int, frames: int) -> mf.SegmentLevel:
        size, shown = delta_bytes[j], psnr[j] if psnr else []
        return mf.SegmentLevel(
            mf.FileEntry(size + sidecar_bytes, HASH) if size else mf.NO_FILE,
            [size // frames] * frames if size else [],
            list(shown), [0.5 + j for _ in shown],
        )  # fmt: skip

    def table(start: int, stop: int) -> mf.Group:
        return mf.Group(
            start=start, stop=stop, count=10 * tiers, static=0, unused=0, left_out=[], repairs=[], colour_transform="",
            grid=mf.Grid([0, 0, 0], 0.01, 0), keyframe_steps=mf.KeyframeSteps(*[0.1] * 5),
            delta_steps=mf.DeltaSteps(*[0.1] * 6), tiers=keyframe_tiers, levels=[atlas] * levels,
            segments=[mf.Segment(start, stop, [level(j, stop - start) for j in range(levels)])],
        )  # fmt: skip

    sidecar, stops = mf.FileEntry(sidecar_bytes, HASH), accumulate(groups)
    keyframe_tiers = [
        mf.GroupTier(10, 1.0, sidecar, [keyframe] * qualities, [mf.FileEntry(size, HASH) for size in row])
        for row in keyframe_bytes
    ]
    return Manifest(
        version=mf.VERSION, generator=mf.Generator("test", {}, {}), attribution="", decisions=[], sh_degree=0,
        frame_rate=list(fps), timescale=fps[0] * 100, frames=sum(groups), keyframe_gain=3.0, delta_gain=6.0,
        region=region(), world=None, origin=None, poster=None, sound=None, live=False, tiers=tiers,
        init=mf.FileEntry(50, HASH),
        views=mf.Views(24, 12 if psnr else 0, "original" if psnr else "none"),
        qualities=[mf.KeyframeQuality(f"Q{q}", 1.0 + 2 * q, q) for q in range(qualities)],
        levels=[mf.Level(f"L{j}", 0.1 * j, 1.0 + j, tiers, 0) for j in range(levels)],
        rungs=[
            [mf.RungQuality(of[q], 0.1, of[q] - 2, 0.9, 0.5 + j, 12) for j, of in enumerate(psnr)]
            for q in range(qualities)
        ] if psnr else [],
        groups=in_groups([table(stop - size, stop) for size, stop in zip(groups, stops, strict=True)], table_bytes),
    )  # fmt: skip


def keeping(m: Manifest, number: int = 2, of: int = 1, pictures: Sequence[bool] = (True, False)) -> Manifest:
    """The manifest with a group whose keyframes are differences; a tier of which nothing differs has no pictures."""
    groups, tiers = list(m.groups), []
    for tier, there in zip(groups[number - 1].tiers, pictures, strict=True):
        files = tier.pictures if there else [mf.NO_FILE] * len(tier.pictures)
        atlases = [replace(a, centres=[0, 0, 0, *a.centres], max_error=[0.0, *a.max_error]) for a in tier.qualities]
        if not there:
            atlases = [replace(atlas, rows=0, planes=[]) for atlas in atlases]
        tiers.append(replace(tier, qualities=atlases, pictures=files))
    groups[number - 1] = replace(groups[number - 1], tiers=tiers, base=of)
    return replace(m, groups=in_groups(groups))
