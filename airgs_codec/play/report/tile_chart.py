"""The tiles of a session over time, as a chart and in words."""

from __future__ import annotations

from typing import Any

import numpy as np

from airgs_codec.play.session import SessionLog
from airgs_codec.play.tile_figures import TileFigures

_GREEN, _ORANGE, _RED = "#3a9a5b", "#e08a1e", "#c8453b"


def tile_words(figures: TileFigures) -> str:
    """What was fetched and what was lacking."""
    sizes = ", ".join(f"{size / 1e3:.0f}" for size in figures.bytes)
    return (
        f"{100 * figures.fetched:.0f} % fetched, {figures.late} after their segment had begun; "
        f"one in sight was lacking for {figures.missing_s:.2f} s; kB of each: {sizes}"
    )


def plot_tiles(axis: Any, log: SessionLog) -> None:
    """A row for every tile: when it could be shown, from when it came late, and when it was lacking in sight."""
    assert log.tiles is not None, "only of a session in which tiles were fetched by view"
    fps, count = log.catalogue.fps, log.catalogue.manifest.tiles
    for position, entry in enumerate(log.shown):
        end_s = entry.start_s + entry.frames / fps
        for event in log.tiles.came(position):
            from_s, late = max(entry.start_s, event.ready_s), event.ready_s > entry.start_s
            if from_s < end_s:
                axis.plot([from_s, end_s], [event.tile] * 2, color=_ORANGE if late else _GREEN, linewidth=4)
    ticks, tiles = np.nonzero(log.tiles.missing)
    axis.plot(log.tiles.tick_times[ticks], tiles, "|", color=_RED, ms=6)
    axis.set_yticks(range(count), [str(tile + 1) for tile in range(count)], fontsize=8)
    title = "Tiles that can be shown (orange: they came late; red: lacking in sight)"
    axis.set(ylabel="tile", title=title, ylim=(count - 0.5, -0.5))
