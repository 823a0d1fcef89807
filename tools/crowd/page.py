"""The page of a measured crowd: inputs, what it costs, what viewers got, and a sentence below every picture."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from tools.crowd.costs import Measured, Prices, cost
from tools.crowd.figures import ALL, Row
from tools.crowd.runs import Run

VIEWER_HOURS, MEDIA_HOURS = 10_000.0, 1.0  # of the example: as many viewers for an hour


@dataclass(frozen=True, slots=True)
class Made:
    """How the figures came about."""

    command: str
    words: str  # machine, versions, and what else is to be said
    rungs: Sequence[Row]
    stored: Sequence[Row]
    prices: Prices
    encode_core_s: float  # core seconds for a second of media; 0 where nobody measured it


def page(runs: Sequence[Run], made: Made) -> str:
    """Three sections in Markdown."""
    parts = [_inputs(runs, made), _costs(runs, made), _crowd(runs, made)]
    return "\n".join(line for part in parts for line in part) + "\n"


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """A table in Markdown, and the empty line after it."""
    lines = [head, ["---"] * len(head), *rows]
    return [f"| {' | '.join(line)} |" for line in lines] + [""]


def _inputs(runs: Sequence[Run], made: Made) -> Iterator[str]:
    yield "## Origin, edge, viewers\n"
    rungs = [made.rungs[0], made.rungs[len(made.rungs) // 2], made.rungs[-1]]
    yield from table(
        ["rung", "PSNR, dB", "Mbit/s", "MB a minute", "files a second"],
        [[r["rung"], f"{r['psnr']:.1f}", *(f"{r[k]:.3g}" for k in ("mbps", "mb_minute", "files_s"))] for r in rungs],
    )
    total = {key: sum(row[key] for row in made.stored) for key in ("mb_minute", "files_s")}
    yield from table(
        ["at the origin", "MB a minute of media", "files a second of media"],
        [[r["kind"], f"{r['mb_minute']:.3g}", f"{r['files_s']:.3g}"] for r in [*made.stored, {"kind": ALL} | total]],
    )
    run = _widest(runs)
    row = run.rows[-1]
    yield from table(
        ["a viewer, no bottleneck", "measured"],
        [
            ["requests a second", f"{row['requests_s']:.1f}"],
            ["Mbit/s, with headers", f"{row['mbps']:.2f}"],
            ["PSNR, dB", f"{row['psnr']:.2f}"],
        ],
    )


def _widest(runs: Sequence[Run]) -> Run:
    """The first run whose viewers have no limit in common; the first of all where each has."""
    return next((run for run in runs if run.bottleneck_mbps is None), runs[0])


def measured_of(runs: Sequence[Run], made: Made) -> Measured:
    """What the cost model takes from the run without a limit."""
    run = _widest(runs)
    return Measured(
        viewer_mbps=run.rows[-1]["mbps"],
        viewer_requests_s=run.rows[-1]["requests_s"],
        byte_hit_rate=run.edge["byte_hit_rate"],
        request_hit_rate=run.edge["request_hit_rate"],
        stored_mb_minute=sum(row["mb_minute"] for row in made.stored),
        encode_core_s_second=made.encode_core_s,
    )


def _costs(runs: Sequence[Run], made: Made) -> Iterator[str]:
    yield "## What it costs\n"
    bill, p = cost(measured_of(runs, made), made.prices, VIEWER_HOURS, MEDIA_HOURS), made.prices
    rows = [
        ["bytes to viewers", f"{p.edge_gb:g} a GB", f"{bill.edge_bytes:.2f}"],
        ["requests to the edge", f"{p.edge_million:g} a million", f"{bill.edge_requests:.2f}"],
        ["bytes from the origin", f"{p.origin_gb:g} a GB", f"{bill.origin_bytes:.2f}"],
        ["requests to the origin", f"{p.origin_million:g} a million", f"{bill.origin_requests:.2f}"],
        ["storage for a month", f"{p.storage_gb_month:g} a GB", f"{bill.storage:.2f}"],
    ]
    rows += [["encoding", f"{p.encode_core_hour:g} a core hour", f"{bill.encoding:.2f}"]] * (made.encode_core_s > 0)
    yield from table(["item", "price, an example", "cost"], [*rows, ["all", "", f"{bill.total:.2f}"]])


def _crowd(runs: Sequence[Run], made: Made) -> Iterator[str]:
    yield "## Ten thousand viewers\n"
    yield f"```sh not-run\n{made.command}\n```\n"
    yield f"{made.words}\n"
    yield from table(
        ["bottleneck", "policies", "edge, Mbit/s", "origin, Mbit/s", "byte hits", "request hits", "requests/s"],
        [_edge_cells(run) for run in runs],
    )
    head = ["bottleneck", "policies", "viewers of", "stalled", "s/hour", "start-up s, 50/95/99 %", "PSNR, dB"]
    head += ["5th %", "Mbit/s", "Jain PSNR", "Jain Mbit/s"]
    yield from table(head, [_viewer_cells(run, row) for run in runs for row in run.rows])
    for name, sentence in conclusions(runs).items():
        yield f"![{name}](crowd-{name}.png)\n\n{sentence}\n"
    yield f"A crowd took {min(r.wall_s for r in runs):.0f} to {max(r.wall_s for r in runs):.0f} s."


def _edge_cells(run: Run) -> list[str]:
    e = run.edge
    rates = [f"{e[key]:,.0f}" for key in ("busy_edge_mbps", "busy_origin_mbps")]
    shares = [f"{100 * e[key]:.2f} %" for key in ("byte_hit_rate", "request_hit_rate")]
    return [_limit(run), run.population, *rates, *shares, f"{e['busy_requests_s']:,.0f}"]


def _limit(run: Run) -> str:
    return run.bottleneck if run.bottleneck_mbps is None else f"{run.bottleneck}: {run.bottleneck_mbps:,.0f} Mbit/s"


def _viewer_cells(run: Run, row: Row) -> list[str]:
    startup = "/".join(f"{row[f'startup_p{p}_s']:.2f}" for p in (50, 95, 99))
    quality = [f"{row['psnr']:.2f}", f"{row['psnr_low']:.2f}", f"{row['mbps']:.2f}"]
    waits = [f"{100 * row['stalled_share']:.1f} %", f"{row['stall_s_hour']:.0f}", startup]
    fair = [f"{row['jain_psnr']:.4f}", f"{row['jain_bitrate']:.3f}"]
    return [run.bottleneck, "mixed" if len(run.policies) > 1 else "alone", row["policy"], *waits, *quality, *fair]


def conclusions(runs: Sequence[Run]) -> dict[str, str]:
    """A sentence for every picture, by its name."""
    return {"cache": _of_cache(runs), "egress": _of_egress(runs), "stalls": _of_stalls(runs), "policies": _of_mix(runs)}


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
