"""A package in the paper's frame mode over links, with each way to choose levels, beside the integer programme.

Only states are sent; a frame is pushed every 1 / R seconds, and the rate of that moment is known.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from airgs_codec._settings import setting
from airgs_codec.package.package import open_package
from airgs_codec.play.offers import Offers
from airgs_codec.play.study import offsets_of
from airgs_codec.play.trace import Link, Trace
from tools.lab.options import required
from tools.lab.page import Page, Section, Table
from tools.lab.paper.frames import CHOOSERS, frame_options, frame_programme, frame_table, simulate_frames

if TYPE_CHECKING:
    from tools.lab.command import Lab

COLUMNS = {
    "chooser": ("levels", ""),
    "kb_frame": ("kB a frame", ".2f"),
    "psnr": ("PSNR sent, dB", ".2f"),
    "psnr_screen": ("on the screen, dB", ".2f"),
    "mean_ms": ("mean, ms", ".1f"),
    "p95_ms": ("95 %, ms", ".1f"),
    "worst_ms": ("worst, ms", ".0f"),
    "late": ("late", ".1%"),
    "skipped": ("skipped", ".1%"),
    "stale": ("older picture", ".1%"),
    "blank": ("none", ".1%"),
}


@dataclass(frozen=True, slots=True)
class Options:
    """What is streamed over what."""

    package: Path = required("folder of a package")
    traces: tuple[str, ...] = required("traces, as airgs-play takes them")
    offsets: int = setting(8, "starts in each trace")
    loops: int | None = setting(None, "times that the sequence is played; as airgs-play where not told")
    scale: float = setting(1.0, "factor on the rates of the traces")
    seed: int = setting(1, "of the starts")


def run(options: Options, lab: Lab) -> Page:
    """Stream all of it. Raises ConfigError, FormatError, TransportError."""
    c = Offers.of(open_package(options.package))
    loops = c.loops(options.loops)
    links = []
    for name in options.traces:
        trace = Trace.open(name)
        starts = offsets_of(trace, options.offsets, options.seed)
        links += [Link.over(trace.cut(start, options.scale).ending("loop")) for start in starts]
    runs = [{"chooser": n} | frame_table(simulate_frames(c, link, n, loops)) for n in CHOOSERS for link in links]
    programmes = [frame_programme(frame_options(c, False) * loops, c.fps, link) for link in links]
    return page(runs, programmes)


def page(runs: Sequence[Mapping[str, Any]], programmes: Sequence[Mapping[str, float]]) -> Page:
    """Means over runs, and what the programme has over the same links."""
    rows = [means(name, [run for run in runs if run["chooser"] == name]) for name in CHOOSERS]
    best = mean_of(p["psnr"] for p in programmes)
    greedy = next(row["psnr"] for row in rows if row["chooser"] == "paper-no-cliff")
    seconds = mean_of(p["solve_s"] for p in programmes)
    answer = (
        f"Over {len(programmes)} links the integer programme (eq. 13) has {best:.2f} dB over the frames of which a "
        f"level fits, the choice of each frame alone {greedy:.2f} dB; solving it takes {1e3 * seconds:.0f} ms a link."
    )
    return Page([Section(answer, tables=[Table("frames", rows, COLUMNS)])])


def means(name: str, runs: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """The mean of every figure over the runs where it is known."""
    return {"chooser": name, "runs": len(runs)} | {
        key: mean_of(run[key] for run in runs) for key in runs[0] if key != "chooser"
    }


def mean_of(values: Iterable[float]) -> float:
    """Mean of the values that are known; NaN where none is."""
    known = [value for value in values if not np.isnan(value)]
    return float(np.mean(known)) if known else np.nan
