"""How long the frames of a finished run take over a link: python -m tools.baselines.stream RUN … --traces TRACE …

A run is a folder as `method.run_method` leaves it. Its frames are pushed one every 1 / R seconds, as the paper streams;
no method here has levels, so that every frame is sent, whatever it weighs, and one that is late holds up the next.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from airgs_codec._report import table
from airgs_codec.errors import AirgsError, ConfigError
from airgs_codec.play.figures import FRAME_FIGURES
from airgs_codec.play.frame_mode import choose_top, push_frames
from airgs_codec.play.frame_table import frame_table
from airgs_codec.play.ladder import Option
from airgs_codec.play.link import Link
from airgs_codec.play.study import offsets_of
from airgs_codec.play.trace import open_trace
from tools.baselines.method import RECORD, Frame

SESSION_S = 30.0  # of play, for which the frames are pushed over and over


def stream(frames: Sequence[Frame], fps: float, link: Link) -> dict[str, Any]:
    """The figures of frame mode for a run whose frames are pushed over and over for about SESSION_S.

    Raises ConfigError without frames, TransportError for a trace that ends too soon.
    """
    options = [(Option(0, frame.bytes, frame.psnr, 0.0),) for frame in frames]
    loops = max(1, round(SESSION_S * fps / max(1, len(options))))
    return frame_table(push_frames(options * loops, fps, link, choose_top))


def read_frames(folder: Path) -> list[Frame]:
    """The frames of a run. Raises ConfigError where there is none."""
    try:
        return [Frame(**entry) for entry in json.loads((folder / RECORD).read_text())["done"]]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ConfigError(f"{folder}: expected a run with {RECORD}, got {error}") from error


def main(argv: Sequence[str] | None = None) -> int:
    """Print a table with a row for each run: means over traces and seeded offsets, as studies draw them."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("runs", nargs="+", type=Path, metavar="RUN")
    parser.add_argument("--traces", nargs="+", required=True, metavar="TRACE")
    parser.add_argument("--fps", type=float, default=30.0)
    parser.add_argument("--offsets", type=int, default=8, help="starts in each trace")
    parser.add_argument("--scale", type=float, default=1.0, help="factor on the rates of traces")
    args = parser.parse_args(argv)
    try:
        wholes = [open_trace(name) for name in args.traces]
        links = [
            Link.over(whole.cut(offset, args.scale).ending("loop"))
            for whole in wholes
            for offset in offsets_of(whole, args.offsets, 1)
        ]
        shown = [f for f in FRAME_FIGURES if (f.headline or f.name == "late") and f.name != "skipped"]
        cells = []
        for run in args.runs:
            rows = [stream(read_frames(run), args.fps, link) for link in links]
            cells.append([run.name, *(f.text(float(np.nanmean([row[f.name] for row in rows]))) for f in shown)])
    except AirgsError as error:
        print(f"stream: {error}", file=sys.stderr)
        return 2
    print("\n".join(table(["run", *(figure.heading for figure in shown)], cells)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
