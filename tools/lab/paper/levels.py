"""The dense level space of a package, 0 to 100 % of the updates pruned, with the ladders of Algorithm 1 on it."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from airgs_codec.errors import ConfigError
from airgs_codec.package.package import open_package
from airgs_codec.render import read_cameras
from airgs_codec.scene.sequence import open_sequence
from tools.lab import Lab, Page, Picture, Section, Table, content, required, setting
from tools.lab.paper.dense import (
    BEST_RANKING,
    DROP,
    HOLD,
    DenseLevel,
    cost_of_saving,
    measure_dense,
    pruning_levels,
    saving_levels,
    split_at_cliff,
)
from tools.lab.paper.states import MEASURED, checking_views

if TYPE_CHECKING:
    from matplotlib.figure import Figure


PAPER_SAVING, PAPER_COST = 0.42, 2.3  # 1.9 -> 1.1 MB a frame on HiFi4G, and its dB
PRUNED = {
    "ranking": ("ranked by", ""), "pruned": ("pruned", ".0%"), "kb_frame": ("state kB a frame", ".2f"),
    "psnr_held": ("withheld, dB", ".2f"), "psnr_dropped": ("not drawn, dB", ".2f"),
}  # fmt: skip
LADDERS = {
    "ladder": ("ladder", ""), "level": ("level", ""), "kb_frame": ("state kB a frame", ".2f"), "psnr": ("dB", ".2f"),
    "ssim": ("SSIM", ".4f"), "before_cliff": ("before the cliff", ""),
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Options:
    package: Path = required("folder of a package")
    against: Path = setting(Path("tests/data/fox"), "the original sequence")
    views: Path | None = setting(None, "cameras, in place of those of the original or of views drawn")


def run(options: Options, lab: Lab) -> Page:
    package = open_package(options.package)
    frames = package.manifest.frames
    original = open_sequence(options.against)
    if len(original) != frames:
        raise ConfigError(f"{options.against}: expected {frames} frames, got {len(original)}")
    cameras = read_cameras(options.views) if options.views else list(original.cameras)
    training, measured = checking_views(package.manifest.region, cameras)
    reads = {"package": content(options.package), "against": options.against, "views": options.views}
    jobs = os.cpu_count() or 1
    make = lambda: measure_dense(package, measured, training, original, jobs, lab.progress)  # noqa: E731
    levels = lab.results.once("dense", reads, make)
    return page(levels, frames)


def page(levels: Sequence[DenseLevel], frames: int) -> Page:
    pruned = Table("pruned", list(_pruned_rows(levels, frames)), PRUNED)
    ladders = {title: list(_ladder_rows(title, some, frames)) for title, some in _ladders(levels).items()}
    rows = [row for some in ladders.values() for row in some]
    answers = [_answer(title, some) for title, some in _ladders(levels).items()]
    draw = partial(_draw, levels, pruned.rows, rows)
    picture = Picture("dense", "Quality by pruned share and by bytes of the state", draw, (12, 4.8))
    return Page(
        [
            Section(
                " ".join(answers), "What does pruning updates cost, and which levels does Algorithm 1 keep?", [picture]
            )
        ],
        "PSNR is that of the squared error pooled over views and frames.",
        data=[pruned, Table("ladders", rows, LADDERS)],
        more={"levels": [_plain(level) for level in levels]},
    )


def _pruned_rows(levels: Sequence[DenseLevel], frames: int) -> Any:
    for ranking in MEASURED:
        held, dropped = (pruning_levels(levels, ranking, semantics) for semantics in (HOLD, DROP))
        for a, b in zip(held, dropped, strict=True):
            place = {"ranking": ranking, "pruned": a.pruning.pruned, "kb_frame": a.bytes / frames / 1e3}
            yield place | {"psnr_held": a.psnr, "psnr_dropped": b.psnr}


def _ladders(levels: Sequence[DenseLevel]) -> dict[str, list[DenseLevel]]:
    return {
        f"pruning alone, by {BEST_RANKING}": pruning_levels(levels, BEST_RANKING),
        "pruning alone, by hits (the paper's)": pruning_levels(levels, "hits"),
        "pairs of pruned share and step": saving_levels(levels),
    }


def _ladder_rows(title: str, levels: Sequence[DenseLevel], frames: int) -> Any:
    for part, before in zip(split_at_cliff(levels), (True, False), strict=True):
        for level in part:
            name = f"{100 * level.pruning.pruned:.0f} %, x{level.pruning.factor:g}"
            place = {"ladder": title, "level": name, "kb_frame": level.bytes / frames / 1e3}
            yield place | {"psnr": level.psnr, "ssim": level.ssim, "before_cliff": before}


def _answer(title: str, levels: Sequence[DenseLevel]) -> str:
    kept, _ = split_at_cliff(levels)
    top, last = kept[0], kept[-1]
    saved = 100 * (1 - last.bytes / max(1, top.bytes))
    return (
        f"{title[0].upper()}{title[1:]}: the last level before the cliff saves {saved:.0f} % of the state for "
        f"{top.psnr - last.psnr:.2f} dB; {100 * PAPER_SAVING:.0f} % cost {cost_of_saving(levels, PAPER_SAVING):.2f} dB "
        f"(the paper: {PAPER_COST} dB)."
    )


def _plain(level: DenseLevel) -> dict[str, Any]:
    place = {"segment": level.segment, "ranking": level.pruning.ranking, "semantics": level.semantics}
    place |= {"pruned": level.pruning.pruned, "factor": level.pruning.factor}
    return place | {"bytes": level.bytes, "psnr_pooled": level.psnr, "ssim": level.ssim}


def _draw(levels: Sequence[DenseLevel], pruned: Any, ladders: Any, figure: Figure) -> None:
    """Quality over the pruned share for each ranking, and over bytes for the ladders."""
    shares, sizes = figure.subplots(1, 2)
    for i, ranking in enumerate(MEASURED):
        some = [row for row in pruned if row["ranking"] == ranking]
        x = [100 * row["pruned"] for row in some]
        shares.plot(x, [row["psnr_held"] for row in some], "o-", color=f"C{i}", label=ranking)
        shares.plot(x, [row["psnr_dropped"] for row in some], "x:", color=f"C{i}", label=f"{ranking}, not drawn")
    shares.set(xlabel="updates pruned, %", ylabel="PSNR of the pooled error, dB", title="Withheld (o) or not drawn (x)")
    for i, title in enumerate(dict.fromkeys(row["ladder"] for row in ladders)):
        for before, marker, label in ((True, "o-", title), (False, "x", "_")):
            some = [row for row in ladders if (row["ladder"], row["before_cliff"]) == (title, before)]
            x, y = [row["kb_frame"] for row in some], [row["psnr"] for row in some]
            sizes.plot(x, y, marker, color=f"C{4 + i}", label=label)
    sizes.set(xlabel="state, kB a frame", ylabel="PSNR of the pooled error, dB", title="Ladders (o), left out (x)")
    shares.legend(loc="lower left")
    sizes.legend(loc="lower right")
