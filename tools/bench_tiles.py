"""What spatial tiles cost and save: a scene as one package and in tiles, fetched whole and by view.

    python -m tools.bench_tiles SCENE -o FOLDER [--tiles 8] [--cut halves] [--seconds 12] [--swing 1]
        [--ticks 2] [--segment 0.5] [--keep-all]

SCENE is a Gaussian sequence whose frames are one group, such as `tools.make_wide_scene` writes. The quantiser steps,
levels and key tiers that a calibration of the whole scene finds serve the whole and each tile, a package of its own. A
viewer walks through the viewing region at a pace that varies; the sequence is played over and over, as if every time
were new. What is fetched a second ahead, for the view that is then expected, is drawn for the view that comes, and
compared with the original. FOLDER keeps the packages, which are not made again, and a JSON file with all figures.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from airgs_codec.cli.common import Bar, run_command
from airgs_codec.encoder.calibration.calibrate import calibrate
from airgs_codec.encoder.publish import encode
from airgs_codec.encoder.settings import EncodeSettings
from airgs_codec.encoder.survey import GroupSpan, survey_group
from airgs_codec.encoder.views import plan_views
from airgs_codec.package.store import Package, open_package
from airgs_codec.progress import Progress
from airgs_codec.scene.sequence import GaussianSequence, open_sequence
from tools.tiles.measure import Bench, savings
from tools.tiles.rules import rules_of
from tools.tiles.split import CUTS, HALVES, Tile, restricted, split
from tools.tiles.stock import Stock
from tools.tiles.viewer import Watcher


def main(words: Sequence[str] | None = None) -> int:
    """Run it; the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", type=Path)
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--tiles", type=int, default=8)
    parser.add_argument("--cut", choices=CUTS, default=HALVES, help="boxes in halves, or ranges of the Morton order")
    parser.add_argument("--seconds", type=float, default=12.0, help="of the walk; 0: sizes alone (default: 12)")
    parser.add_argument("--swing", type=float, default=1.0, help="how unsteadily the viewer turns (default: 1)")
    parser.add_argument("--ticks", type=int, default=2, help="pictures of each segment (default: 2)")
    parser.add_argument("--segment", type=float, default=0.5, metavar="S", help="seconds of a segment (default: 0.5)")
    parser.add_argument("--keep-all", action="store_true", help="write all rows, so that tiles have those of the whole")
    args = parser.parse_args(words)

    def run() -> int:
        bar = Bar()
        sequence = open_sequence(args.scene)
        tiles = split(sequence, args.tiles, args.cut)
        settings = EncodeSettings(
            segment_s=args.segment,
            group_frames=len(sequence),
            keep_all=args.keep_all,
            keys="apart",
            rows="keep",
            measure_pictures=0,
        )
        whole, parts = packages(sequence, tiles, args.output / args.cut, settings, bar)
        print("\n".join(size_lines(whole, parts)))
        if args.seconds > 0:
            watcher = Watcher.of(whole.manifest.region, args.seconds, args.swing)
            longest = max(s.stop - s.start for s in whole.manifest.segments) / float(whole.manifest.fps)
            bench = Bench(sequence, whole, parts, tiles, watcher, round(args.seconds / longest), args.ticks)
            rows = bench.run(rules_of(len(whole.manifest.levels)), bar)
            saved = savings(rows)
            table = json.dumps({"rows": rows, "saved": saved}, indent=1)
            (args.output / f"{args.cut}-{args.tiles}-{args.swing:g}.json").write_text(table + "\n", encoding="utf-8")
            print("\n".join(lines(rows, saved)))
        bar.close()
        return 0

    return run_command("bench_tiles", run)


def packages(
    sequence: GaussianSequence, tiles: Sequence[Tile], folder: Path, settings: EncodeSettings, progress: Progress
) -> tuple[Package, list[Package]]:
    """The package of the whole and those of the tiles, with the same settings and viewing region."""
    paths = [folder.parent / "whole"]
    paths += [folder.with_name(f"{folder.name}-{number + 1:02d}-of-{len(tiles):02d}") for number in range(len(tiles))]
    missing = {path for path in paths if not (path / "airgs.json").is_file()}
    if missing:
        views = plan_views(sequence, settings)
        progress("calibration", 0, 1)
        survey = survey_group(sequence, GroupSpan(0, 0, len(sequence)), views)
        settings = replace(calibrate(sequence, survey, settings).apply(settings), region=views.region)
        for path, part in zip(paths, [sequence, *(restricted(sequence, tile) for tile in tiles)], strict=True):
            if path in missing:
                encode(part, path, settings)
    whole, *parts = (open_package(path) for path in paths)
    return whole, parts


def size_lines(whole: Package, parts: Sequence[Package]) -> list[str]:
    """Rows and bytes of the whole and of all tiles, by rung, of one pass through the sequence."""
    rows = [sum(package.manifest.groups[0].count for package in packages) for packages in ([whole], parts)]
    found = [f"rows: {rows[0]}, in tiles {rows[1]}"]
    for place in range(len(whole.manifest.levels)):
        whole_bytes, tile_bytes = (
            sum(fetch_all(package, place) for package in packages) for packages in ([whole], parts)
        )
        more = 100 * (tile_bytes / whole_bytes - 1)
        found.append(f"rung {place}: {whole_bytes / 1e3:.1f} kB, in tiles {tile_bytes / 1e3:.1f} kB, {more:+.1f} %")
    return found


def fetch_all(package: Package, place: int) -> int:
    """Bytes on the wire of a rung of a whole package."""
    stock = Stock.of(package)
    for segment in range(len(package.manifest.segments)):
        stock.fetch(0, segment, stock.ladder()[place])
    return stock.bytes


def lines(rows: Sequence[dict], saved: dict[str, list[float | None]]) -> list[str]:
    """The table for people."""
    found = [f"{'rule':<34}{'rung':>5}{'kB':>9}{'Mbit/s':>8}{'dB':>7}{'worst':>7}{'saved':>8}   at borders, elsewhere"]
    for row in rows:
        places = [other["rung"] for other in rows if other["rule"] == row["rule"]]
        share = saved[row["rule"]][places.index(row["rung"])]
        words = "" if share is None else f"{100 * share:.1f} %"
        edge = f"   {row['border_psnr']:.2f}, {row['elsewhere_psnr']:.2f} dB" if "border_psnr" in row else ""
        found.append(
            f"{row['rule']:<34}{row['rung']:>5}{row['bytes'] / 1e3:>9.1f}{row['mbps']:>8.2f}{row['psnr']:>7.2f}"
            f"{row['worst_psnr']:>7.2f}{words:>8}{edge}"
        )
    return found


if __name__ == "__main__":
    sys.exit(main())
