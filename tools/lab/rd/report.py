"""The curves as a table and a picture."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from airgs_codec._report import plain_log_ticks
from tools.lab.page import Row
from tools.lab.rd.coders import OURS
from tools.lab.rd.points import RdPoint, bd_rate, curves

if TYPE_CHECKING:
    from matplotlib.figure import Figure

STYLES = {"medium": ":", "veryslow": "-", "keeps all": "--"}  # by the last words of a coder's name
ENDS_COLUMNS = {
    "coder": ("coder", ""), "small_kb": ("smallest point, kB a frame", ".1f"), "small_psnr": ("dB", ".1f"),
    "large_kb": ("largest point, kB a frame", ".1f"), "large_psnr": ("dB", ".1f"),
    "rate": ("rate of airgs to its", "+.0%"),
}  # fmt: skip
POINT_COLUMNS = {
    "coder": ("coder", ""), "setting": ("setting", ""), "kb_per_frame": ("kB a frame", ".2f"),
    "psnr": ("PSNR, dB", ".2f"),
    "truth_psnr": ("to pictures", ".2f"), "encode_s": ("encode, s", ".2f"), "decode_s": ("decode, s", ".2f"),
}  # fmt: skip


def ends(points: Sequence[RdPoint], low: float, high: float) -> list[Row]:
    """A row for each coder: the ends of its curve, and how much smaller or larger `airgs` is at equal PSNR."""
    ours = curves(points).get(OURS, [])
    return [
        {
            "coder": name, "small_kb": curve[0].kb_per_frame, "small_psnr": curve[0].psnr,
            "large_kb": curve[-1].kb_per_frame, "large_psnr": curve[-1].psnr,
            "rate": bd_rate(ours, curve, low, high) if name != OURS else None,
        }
        for name, curve in curves(points).items()
    ]  # fmt: skip


def draw(points: Sequence[RdPoint], title: str, figure: Figure) -> None:
    """Bytes against PSNR: a curve for each coder, in one colour for all curves of the same layout."""
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
    axis.legend()
