"""What a package offers a player, from numbers alone: policies choose by it without files or tables.

T key tiers, Q key qualities, L levels.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from airgs_codec.play.ladder import saved_shares
from airgs_codec.play.offers import NONE, KeyOffer, Keys, RungOffer, SegmentOffer

Numbers = Mapping[str, Any]


class NumberOffers:
    """The offers of a package that is played over and over. `numbers` are an offer of the vectors."""

    def __init__(self, numbers: Numbers) -> None:
        self.tiers: list[int] = [level["tiers"] for level in numbers["levels"]]
        self.qualities = len(numbers["groups"][0])
        self.segments = [_segment(numbers, number, self.tiers) for number in range(len(numbers["segments"]))]

    def at(self, position: int) -> SegmentOffer:
        return self.segments[position % len(self.segments)]

    def upcoming(self, position: int, end: int, decoded: Keys) -> Iterator[tuple[SegmentOffer, Keys]]:
        """The segments from a position on, each with what of `decoded`, in the loop of that position, is of use."""
        for p in range(position, end):
            same = p // len(self.segments) == position // len(self.segments)
            yield self.at(p), decoded if same else NONE


def _segment(numbers: Numbers, number: int, tiers: list[int]) -> SegmentOffer:
    """`numbers["groups"]` are (G, Q, T) wire bytes."""
    s = numbers["segments"][number]
    keys, group = numbers["groups"][s["group"]], s["group"]
    saved = saved_shares(s["state_bytes"])
    rungs = [
        RungOffer(
            quality=q,
            level=j,
            psnr=s["psnr"][j][q],
            delta_e=float("nan"),
            gaussians=0,
            allowed=True,
            saved=saved[j],
            keys=tuple(KeyOffer((group, q, tier), (), keys[q][tier]) for tier in range(tiers[j])),
            state=(),
            state_bytes=s["state_bytes"][j],
        )
        for q in range(len(keys))
        for j in range(len(tiers))
    ]
    starts = number == 0 or numbers["segments"][number - 1]["group"] != group
    return SegmentOffer(number, 0, 0, float(s["seconds"]), group, None, starts, tuple(rungs))
