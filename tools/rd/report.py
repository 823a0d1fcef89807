"""The benchmark's figures as CSV, a Markdown table and a picture."""

from __future__ import annotations

import csv
import os
import platform
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from airgs_codec._report import new_figure, plain_log_ticks, save_figure
from airgs_codec.media.h264 import library_versions
from tools.rd.coders import OURS
from tools.rd.points import RdPoint, bd_rate, curves

COUNTED = (
    "Bytes are everything a viewer fetches for the sequence, divided by its frames: of airgs the whole top rung with "
    "both manifests, tables and sidecars; of the layouts every packet, parameter set and range; of the other "
    "formats their files."
)
STYLES = {"medium": ":", "veryslow": "-", "keeps all": "--"}  # by the last words of a coder's name


def write_csv(points: Sequence[RdPoint], path: Path) -> None:
    """One row a point, with the fields of RdPoint."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(asdict(points[0])))
        writer.writeheader()
        writer.writerows(asdict(p) for p in points)


def format_point(p: RdPoint) -> str:
    """One line for the terminal."""
    true = "" if p.truth_psnr is None else f" ({p.truth_psnr:.2f})"
    figures = f"{p.kb_per_frame:8.2f} kB/frame  {p.psnr:6.2f} dB{true}"
    return f"{p.coder:30} {p.setting:8} {figures}  encode {p.encode_s:7.2f} s  decode {p.decode_s:6.2f} s"


def markdown(points: Sequence[RdPoint], low: float, high: float) -> str:
    """A row for each coder: the ends of its curve, and how much smaller or larger `airgs` is at equal PSNR."""
    ours = curves(points).get(OURS, [])
    lines = [
        f"| coder | smallest point, a frame | largest point, a frame | rate of airgs to its, {low:g} to {high:g} dB |",
        "|---|---|---|---|",
    ]
    for name, curve in curves(points).items():
        ends = [f"{p.kb_per_frame:.1f} kB, {p.psnr:.1f} dB" for p in (curve[0], curve[-1])]
        rate = bd_rate(ours, curve, low, high) if name != OURS else None
        lines.append(f"| {name} | {ends[0]} | {ends[1]} | {'' if rate is None else f'{100 * rate:+.0f} %'} |")
    return "\n".join(lines)


def machine() -> str:
    """Where the seconds were measured, and with what."""
    versions = ", ".join(f"{name} {version}" for name, version in library_versions().items())
    return f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}, {versions}"


def plot(points: Sequence[RdPoint], path: Path, title: str) -> None:
    """Bytes against PSNR: a curve for each coder, in one colour for all curves of the same layout."""
    figure = new_figure(9, 5.5)
    axis = figure.subplots()
    families = list(dict.fromkeys(p.coder.split(",")[0] for p in points))
    for coder, curve in curves(points).items():
        style = next((line for words, line in STYLES.items() if coder.endswith(words)), "-")
        colour = f"C{families.index(coder.split(',')[0])}"
        x, y = [p.kb_per_frame for p in curve], [p.psnr for p in curve]
        axis.plot(x, y, f"o{style}", color=colour, label=coder, linewidth=2.5 if coder == OURS else 1.3, markersize=4)
    axis.set(xlabel="kB a frame, everything fetched", ylabel="PSNR, dB (against renderings of the input)", title=title)
    axis.set_xscale("log")
    sizes = [p.kb_per_frame for p in points]
    axis.set_xlim(0.85 * min(sizes), 1.15 * max(sizes))
    plain_log_ticks(axis.xaxis, most=8)
    axis.grid(alpha=0.3)
    axis.legend(fontsize=9)
    save_figure(figure, path, dpi=110)
