"""The dense level space of a package as tables, as JSON and as a picture."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from airgs_codec._report import new_figure, save_figure, table
from airgs_codec.decoder.group_states import MEASURED, SHARES
from airgs_codec.inspect.dense import (
    BEST_RANKING,
    DROP,
    HOLD,
    DenseLevel,
    cost_of_saving,
    pruning_levels,
    saving_levels,
    split_at_cliff,
)

PAPER_SAVING, PAPER_COST = 0.42, 2.3  # 1.9 -> 1.1 MB a frame on HiFi4G, and its dB


def format_dense(levels: Sequence[DenseLevel], frames: int) -> str:
    """Tables of the level space over the whole package of so many frames, and of its ladders."""
    lines = [
        "levels by share of the updates pruned; for each ranking: state kB/frame, then PSNR of the pooled error in dB",
        f"where updates are withheld ({HOLD}) and where the pruned rows are not drawn ({DROP})",
    ]
    head = ["pruned"] + [name for ranking in MEASURED for name in (ranking, HOLD, DROP)]
    columns = [[f"{100 * share:.0f} %" for share in SHARES]]
    for ranking in MEASURED:
        held, dropped = (pruning_levels(levels, ranking, semantics) for semantics in (HOLD, DROP))
        columns += [[f"{_kilobytes(level, frames):.2f}" for level in held]]
        columns += [[f"{level.psnr:.2f}" for level in some] for some in (held, dropped)]
    lines += table(head, [list(row) for row in zip(*columns, strict=True)])
    for title, some in _ladders(levels):
        lines += ["", f"ladder of {title}, beta = 2 (PSNR of the pooled error):", *_ladder_lines(some, frames)]
    return "\n".join(lines)


def _ladders(levels: Sequence[DenseLevel]) -> list[tuple[str, list[DenseLevel]]]:
    return [
        (f"pruning only, by {BEST_RANKING}", pruning_levels(levels, BEST_RANKING)),
        ("pruning only, by hits (the paper's usage frequency)", pruning_levels(levels, "hits")),
        ("pairs of pruned share and step factor", saving_levels(levels)),
    ]


def _ladder_lines(levels: Sequence[DenseLevel], frames: int) -> list[str]:
    kept, _ = split_at_cliff(levels)
    top, last = kept[0], kept[-1]
    saved = 100 * (1 - last.bytes / max(1, top.bytes))
    return [
        *(
            f"  {_words(level):>11}  {_kilobytes(level, frames):7.2f} kB/frame  {level.psnr:.2f} dB  "
            f"SSIM {level.ssim:.4f}"
            for level in kept
        ),
        f"  the last before the cliff saves {saved:.0f} % of the state for {top.psnr - last.psnr:.2f} dB; "
        f"{100 * PAPER_SAVING:.0f} % cost {cost_of_saving(levels, PAPER_SAVING):.2f} dB (paper: {PAPER_COST} dB)",
    ]


def _kilobytes(level: DenseLevel, frames: int) -> float:
    return level.bytes / frames / 1e3


def _words(level: DenseLevel) -> str:
    return f"{100 * level.pruning.pruned:.0f} %, x{level.pruning.factor:g}"


def dense_table(levels: Sequence[DenseLevel]) -> list[dict[str, Any]]:
    """Every level as plain values; `psnr_pooled` is the PSNR of the squared error pooled over views and frames."""
    return [
        {
            "segment": level.segment,
            "ranking": level.pruning.ranking,
            "semantics": level.semantics,
            "pruned": level.pruning.pruned,
            "factor": level.pruning.factor,
            "bytes": level.bytes,
            "psnr_pooled": level.psnr,
            "ssim": level.ssim,
        }
        for level in levels
    ]


def plot_dense(levels: Sequence[DenseLevel], frames: int, path: Path) -> None:
    """A picture: quality over the pruned share for each ranking, and over bytes for the ladders. Raises ConfigError."""
    figure = new_figure(12, 4.8)
    shares, sizes = figure.subplots(1, 2)
    _plot_shares(shares, levels)
    _plot_ladders(sizes, levels, frames)
    for axis, place in ((shares, "lower left"), (sizes, "lower right")):
        axis.grid(alpha=0.3)
        axis.legend(fontsize=8, loc=place)
    save_figure(figure, path, dpi=110)


def _plot_shares(axis: Any, levels: Sequence[DenseLevel]) -> None:
    for i, ranking in enumerate(MEASURED):
        for semantics, line, words in ((HOLD, "o-", ranking), (DROP, "x:", f"{ranking}, not drawn")):
            some = pruning_levels(levels, ranking, semantics)
            x, y = [100 * level.pruning.pruned for level in some], [level.psnr for level in some]
            axis.plot(x, y, line, color=f"C{i}", label=words)
    axis.set(xlabel="updates pruned, %", ylabel="PSNR of the pooled error, dB")
    axis.set_title("Updates withheld (o) or rows not drawn (x), by ranking")


def _plot_ladders(axis: Any, levels: Sequence[DenseLevel], frames: int) -> None:
    for i, (title, some) in enumerate(_ladders(levels)):
        kept, left = split_at_cliff(some)
        for part, marker, words in ((kept, "o-", title), (left, "x", "_")):
            x, y = [_kilobytes(level, frames) for level in part], [level.psnr for level in part]
            axis.plot(x, y, marker, color=f"C{4 + i}", label=words)
    for level in kept:  # of the last ladder, the pairs
        at = (_kilobytes(level, frames), level.psnr)
        axis.annotate(_words(level), at, (0, 7), textcoords="offset points", fontsize=7, ha="center")
    axis.margins(0.08, 0.12)  # room for those words
    axis.set(xlabel="state, kB a frame", ylabel="PSNR of the pooled error, dB")
    axis.set_title("Ladders (o) and what the cliff test leaves out (x)")
