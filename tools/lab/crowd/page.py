"""The page of a measured crowd: what cache and viewers get, what half the link takes away, and what it costs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from functools import partial

from airgs_codec._settings import setting
from airgs_codec.errors import ConfigError
from tools.lab.crowd import pictures
from tools.lab.crowd.figures import ALL
from tools.lab.crowd.runs import Run
from tools.lab.crowd.simulation import CrowdSettings
from tools.lab.page import Page, Picture, Row, Section, Table

WATCHED_H = 10_000.0  # by all viewers together, of the example
COLUMNS = {
    "bottleneck": ("bottleneck", ""), "crowd": ("crowd", ""), "policy": ("viewers of", ""),
    "stalled_share": ("that stall", ".1%"), "startup_p50_s": ("start-up, s", ".2f"), "startup_p95_s": ("95 %", ".2f"),
    "psnr": ("PSNR, dB", ".1f"), "psnr_low": ("5th percentile", ".1f"), "mbps": ("Mbit/s", ".2f"),
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Prices:
    """Of what a cache sends, in one currency; examples to make the arithmetic visible, and nobody's quotes."""

    gb: float = setting(0.02, "price for 10^9 bytes")
    million: float = setting(0.75, "price for 10^6 requests")

    def __post_init__(self) -> None:
        for field in fields(self):
            if not getattr(self, field.name) >= 0:
                raise ConfigError(f"{field.name}: expected a price of 0 or more, got {getattr(self, field.name):g}")


def page(runs: Sequence[Run], settings: CrowdSettings, prices: Prices) -> Page:
    """All of it; `settings` are those of the first run."""
    rows = [named(run, row) for run in runs for row in run.rows]
    words = [cache_words(runs[0]), link_words(runs), cost_words(runs[0], prices)]
    picture = Picture("crowd-cache", "What a cache answers, by its size", partial(pictures.cache, runs[0]), (6.0, 3.6))
    data = [
        Table("crowd", rows),
        Table("crowd-edge", [named(run, run.edge) | {"bottleneck_mbps": run.bottleneck_mbps} for run in runs]),
        Table("crowd-caches", runs[0].cache),
    ]
    section = Section(
        " ".join(filter(None, words)), pictures=[picture], tables=[Table("crowd-viewers", telling(runs), COLUMNS)]
    )
    return Page([section], how_of(runs[0], settings), more={"prices": asdict(prices)}, data=data)


def named(run: Run, row: Row) -> Row:
    """A row of a run with what tells the run from others."""
    return {"bottleneck": run.bottleneck, "policies": run.population} | row


def telling(runs: Sequence[Run]) -> list[Row]:
    """What the first population gets behind every bottleneck, and the policies of others behind the narrowest."""
    first, narrow = runs[0].population, runs[-1].bottleneck
    shown = [run for run in runs if first == run.population or narrow == run.bottleneck]
    crowds = [(run, {"crowd": "mixed" if len(run.policies) > 1 else "alone"}) for run in shown]
    return [named(run, row) | crowd for run, crowd in crowds for row in run.rows if row["policy"] != ALL]


def how_of(run: Run, settings: CrowdSettings) -> str:
    """Who watches what over what."""
    return (
        f"{settings.viewers:,} viewers come within {settings.join_s:g} s and watch {settings.watch_s:g} s each. "
        f"Every one is the real player with a trace of its own; behind the traces lie a shared link, a cache of "
        f"{settings.cache_bytes / 1e6:g} MB, and an origin {1e3 * settings.origin_rtt_s:g} ms away. A bottleneck is a "
        f"share of the {run.busiest_mbps / 1e3:.1f} Gbit/s that the viewers take in their busiest seconds without one."
    )


def cache_words(run: Run) -> str:
    """What the cache spares the origin, and how large it must be."""
    edge, sizes = run.edge, run.cache
    enough = next(row for row in sizes if row["byte_hit_rate"] >= sizes[-1]["byte_hit_rate"] - 0.001)
    return (
        f"In the busiest seconds {edge['busy_viewers']:,} viewers take {edge['busy_edge_mbps'] / 1e3:.1f} Gbit/s from "
        f"the cache, which takes {edge['busy_origin_mbps']:.0f} Mbit/s from the origin: it answers "
        f"{100 * edge['byte_hit_rate']:.2f} % of the bytes, and one of {enough['cache_mb']:g} MB does as well, of "
        f"{edge['files_mb']:.0f} MB of files; one of {sizes[0]['cache_mb']:g} MB answers "
        f"{100 * sizes[0]['byte_hit_rate']:.0f} %."
    )


def link_words(runs: Sequence[Run]) -> str:
    """What the narrowest link changes for the first population; '' where there is one link."""
    mine = [run for run in runs if run.population == runs[0].population]
    if len(mine) < 2:
        return ""
    wide, narrow = mine[0].rows[-1], mine[-1].rows[-1]
    lost = wide["psnr"] - narrow["psnr"]
    much = f"{abs(lost):.1f} dB {'less' if lost >= 0 else 'more'}"
    return (
        f"Behind a bottleneck of {mine[-1].bottleneck} viewers see {much}, and "
        f"{100 * narrow['stalled_share']:.0f} % instead of {100 * wide['stalled_share']:.0f} % stall."
    )


def cost_words(run: Run, prices: Prices) -> str:
    """What an audience costs by the measured bytes and requests, and which of the two to spare."""
    gb, millions = WATCHED_H * 3600 * run.rows[-1]["mbps"] / 8e3, WATCHED_H * 3600 * run.rows[-1]["requests_s"] / 1e6
    sent, asked = gb * prices.gb, millions * prices.million
    ways = ("longer groups", "fewer bytes") if asked > sent else ("fewer bytes", "longer groups")
    return (
        f"At {prices.gb:g} a GB and {prices.million:g} a million requests, examples, {WATCHED_H:,.0f} hours watched "
        f"cost {sent:,.0f} for bytes and {asked:,.0f} for requests: {ways[0]} save more than {ways[1]}."
    )
