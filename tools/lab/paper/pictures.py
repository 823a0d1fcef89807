"""The picture of a reproduction."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from tools.lab.paper.training import PAPER, SEEDED, SUMMED, Trained

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLOURS = {
    "airgs": "#d62728",
    PAPER: "#ff7f0e",
    SEEDED: "#ff7f0e",
    SUMMED: "#000000",
    "v3": "#1f77b4",
    "3dgstream": "#2ca02c",
    "4dgs": "#9467bd",
    "naive3dgs": "#7f7f7f",
}


def draw_quality(trained: Sequence[Trained], figure: Figure) -> None:
    """PSNR of every frame, a panel a scene; dots are keyframes of methods that have other frames."""
    names = list(dict.fromkeys(t.scene for t in trained))
    for name, axis in zip(names, figure.subplots(1, len(names), squeeze=False)[0], strict=True):
        for t in (t for t in trained if t.scene == name and t.method in COLOURS):
            style = {"color": COLOURS[t.method], "linestyle": "--" if t.method.startswith("paper") else "-"}
            axis.plot([f.psnr for f in t.frames], label=t.method, **style)
            keyframes = [i for i, f in enumerate(t.frames) if f.kind == "keyframe"]
            if len(keyframes) < len(t.frames):
                axis.plot(keyframes, [t.frames[i].psnr for i in keyframes], "o", markersize=4, color=style["color"])
        axis.set(title=name, xlabel="frame", ylabel="PSNR at held-out cameras, dB")
    figure.legend(*axis.get_legend_handles_labels(), loc="outside lower center", ncols=4, fontsize=8)
