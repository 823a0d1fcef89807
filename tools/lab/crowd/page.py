"""The page of a measured crowd: inputs, what it costs, what viewers got, and a sentence for every picture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import partial

from tools.lab.crowd import pictures
from tools.lab.crowd.costs import Measured, Prices, cost
from tools.lab.crowd.figures import ALL
from tools.lab.crowd.runs import Run
from tools.lab.page import Page, Picture, Row, Section, Table

VIEWER_HOURS, MEDIA_HOURS = 10_000.0, 1.0  # of the example: as many viewers for an hour
RUNG_COLUMNS = {
    "rung": ("rung", ""), "psnr": ("PSNR, dB", ".1f"), "mbps": ("Mbit/s", ".3g"), "mb_minute": ("MB a minute", ".3g"),
    "files_s": ("files a second", ".3g"),
}  # fmt: skip
STORED_COLUMNS = {
    "kind": ("at the origin", ""), "mb_minute": ("MB a minute of media", ".3g"),
    "files_s": ("files a second of media", ".3g"),
}  # fmt: skip
COST_COLUMNS = {"item": ("item", ""), "price": ("price, an example", ""), "cost": ("cost", ".2f")}
EDGE_COLUMNS = {
    "bottleneck": ("bottleneck", ""), "bottleneck_mbps": ("Mbit/s", ",.0f"), "policies": ("policies", ""),
    "busy_edge_mbps": ("edge, Mbit/s", ",.0f"), "busy_origin_mbps": ("origin, Mbit/s", ",.0f"),
    "byte_hit_rate": ("byte hits", ".2%"), "request_hit_rate": ("request hits", ".2%"),
    "busy_requests_s": ("requests/s", ",.0f"), "wall_s": ("simulated in, s", ".0f"),
}  # fmt: skip
VIEWER_COLUMNS = {
    "bottleneck": ("bottleneck", ""), "policies": ("policies", ""), "policy": ("viewers of", ""),
    "stalled_share": ("stalled", ".1%"), "stall_s_hour": ("s/hour", ".0f"), "startup_p50_s": ("start-up, s", ".2f"),
    "startup_p95_s": ("95 %", ".2f"), "startup_p99_s": ("99 %", ".2f"), "psnr": ("PSNR, dB", ".2f"),
    "psnr_low": ("5th %", ".2f"), "mbps": ("Mbit/s", ".2f"), "jain_psnr": ("Jain PSNR", ".4f"),
    "jain_bitrate": ("Jain Mbit/s", ".3f"), "requests_s": ("requests a second", ".1f"),
}  # fmt: skip
CACHE_COLUMNS = {
    "policies": ("policies", ""), "bottleneck": ("bottleneck", ""), "cache_mb": ("cache, MB", "g"),
    "request_hit_rate": ("request hits", ".2%"), "byte_hit_rate": ("byte hits", ".2%"),
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Inputs:
    """What of the package and the prices the page tells."""

    rungs: Sequence[Row]
    stored: Sequence[Row]
    prices: Prices
    encode_core_s: float  # core seconds for a second of media; 0 where nobody measured it


def page(runs: Sequence[Run], inputs: Inputs) -> Page:
    """All of it."""
    wide = len(pictures.most_mixed(runs))
    made = {
        "cache": ("Hit rate by cache size", _of_cache(runs), pictures.cache, (6.0, 3.6)),
        "egress": ("What the edge and the origin send over time", _of_egress(runs), pictures.egress, (9.0, 3.6)),
        "stalls": ("Start-up and waiting by bottleneck", _of_stalls(runs), pictures.stalls, (9.0, 3.6)),
        "policies": ("PSNR and bit rate by policy", _of_mix(runs), pictures.policies, (3.4 * wide, 5.6)),
    }
    sections = [
        Section(sentence, f"{caption}?", [Picture(f"crowd-{name}", caption, partial(draw, runs), size)])
        for name, (caption, sentence, draw, size) in made.items()
    ]
    seconds = [[asdict(second) for second in run.seconds] for run in runs]
    more = {"prices": asdict(inputs.prices), "seconds_of_crowds": seconds}
    return Page([_inputs(inputs), _costs(runs, inputs), _viewers(runs), *sections], more=more)


def _inputs(inputs: Inputs) -> Section:
    total = {"kind": ALL} | {key: sum(row[key] for row in inputs.stored) for key in ("mb_minute", "files_s")}
    tables = [
        Table("crowd-rungs", inputs.rungs, RUNG_COLUMNS),
        Table("crowd-stored", [*inputs.stored, total], STORED_COLUMNS),
    ]
    words = f"A minute of media takes {total['mb_minute']:.3g} MB in {60 * total['files_s']:.0f} files."
    return Section(words, "What do origin and viewers need?", tables=tables)


def _costs(runs: Sequence[Run], inputs: Inputs) -> Section:
    bill, p = cost(measured_of(runs, inputs), inputs.prices, VIEWER_HOURS, MEDIA_HOURS), inputs.prices
    items = [
        ("bytes to viewers", f"{p.edge_gb:g} a GB", bill.edge_bytes),
        ("requests to the edge", f"{p.edge_million:g} a million", bill.edge_requests),
        ("bytes from the origin", f"{p.origin_gb:g} a GB", bill.origin_bytes),
        ("requests to the origin", f"{p.origin_million:g} a million", bill.origin_requests),
        ("storage for a month", f"{p.storage_gb_month:g} a GB", bill.storage),
    ]
    items += [("encoding", f"{p.encode_core_hour:g} a core hour", bill.encoding)] * (inputs.encode_core_s > 0)
    items.append(("all", "", bill.total))
    rows = [dict(zip(COST_COLUMNS, item, strict=True)) for item in items]
    words = f"{VIEWER_HOURS:,.0f} hours watched of an hour of media cost {bill.total:.2f} at these prices, examples."
    return Section(words, "What does it cost?", tables=[Table("crowd-costs", rows, COST_COLUMNS)])


def _viewers(runs: Sequence[Run]) -> Section:
    named = [(run, {"bottleneck": run.bottleneck, "policies": run.population}) for run in runs]
    shared = ("bottleneck_mbps", "wall_s", "cpu_s")
    edges = [known | run.edge | {name: getattr(run, name) for name in shared} for run, known in named]
    viewers = [known | row for run, known in named for row in run.rows]
    caches = [known | row for run, known in named for row in run.cache]
    tables = [
        Table("crowd-edge", edges, EDGE_COLUMNS),
        Table("crowd", viewers, VIEWER_COLUMNS),
        Table("crowd-cache", caches, CACHE_COLUMNS),
    ]
    busy = max(row["busy_viewers"] for row in edges)
    return Section(f"{busy:,} viewers watch at once.", "What do viewers get?", tables=tables)


def _widest(runs: Sequence[Run]) -> Run:
    """The first run whose viewers have no limit in common; the first of all where each has."""
    return next((run for run in runs if run.bottleneck_mbps is None), runs[0])


def measured_of(runs: Sequence[Run], inputs: Inputs) -> Measured:
    """Return what the cost model takes from the run without a limit."""
    run = _widest(runs)
    return Measured(
        viewer_mbps=run.rows[-1]["mbps"],
        viewer_requests_s=run.rows[-1]["requests_s"],
        byte_hit_rate=run.edge["byte_hit_rate"],
        request_hit_rate=run.edge["request_hit_rate"],
        stored_mb_minute=sum(row["mb_minute"] for row in inputs.stored),
        encode_core_s_second=inputs.encode_core_s,
    )


def _of_cache(runs: Sequence[Run]) -> str:
    rows = runs[0].cache
    best = rows[-1]["byte_hit_rate"]
    enough = next(row for row in rows if row["byte_hit_rate"] >= best - 0.001)
    return (
        f"A cache of {rows[0]['cache_mb']:g} MB answers {100 * rows[0]['byte_hit_rate']:.1f} % of the bytes and one of "
        f"{enough['cache_mb']:g} MB {100 * enough['byte_hit_rate']:.2f} %, within 0.1 % of what any larger one does; "
        f"all files that were asked for are {runs[0].edge['files_mb']:.0f} MB."
    )


def _of_egress(runs: Sequence[Run]) -> str:
    e = _widest(runs).edge
    return (
        f"In the busiest seconds {e['busy_viewers']:,} viewers take {e['busy_edge_mbps']:,.0f} Mbit/s from the edge, "
        f"which takes {e['busy_origin_mbps']:,.0f} Mbit/s from the origin, one part in "
        f"{e['busy_edge_mbps'] / max(e['busy_origin_mbps'], 1e-9):,.0f}."
    )


def _of_stalls(runs: Sequence[Run]) -> str:
    mine = [run for run in runs if run.population == runs[0].population]
    parts = [
        f"{100 * run.rows[-1]['stalled_share']:.1f} % of the viewers stall behind {_called(run)} "
        f"({run.rows[-1]['stall_s_hour']:.0f} s an hour, {run.rows[-1]['psnr']:.1f} dB)"
        for run in mine
    ]
    return f"With {mine[0].population}, {', '.join(parts)}."


def _called(run: Run) -> str:
    return "no bottleneck" if run.bottleneck_mbps is None else f"one of {run.bottleneck}"


def _of_mix(runs: Sequence[Run]) -> str:
    mixed = [run for run in runs if len(run.policies) > 1]
    if not mixed:
        return "All viewers have one policy."
    run = mixed[-1]
    rows = sorted((row for row in run.rows if row["policy"] != ALL), key=lambda row: -row["mbps"])
    parts = [f"{r['policy']} {r['mbps']:.2f} Mbit/s, {r['psnr']:.1f} dB, {r['stall_s_hour']:.0f} s/h" for r in rows]
    return f"Side by side behind {_called(run)}, they get (with stalls an hour): {'; '.join(parts)}."
