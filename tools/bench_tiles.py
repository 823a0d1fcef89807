"""What spatial tiles cost and save: sessions over a scene as one package, in tiles, and in tiles fetched by view.

    python -m tools.bench_tiles SCENE -o FOLDER [--tiles 8] [--segment 0.5] [--seconds 12] [--viewers lively calm even]
        [--rungs 1] [--times 1.2 2 4] [--trace TRACE] [--view-buffer 1] [--ticks 2] [--keep-all]

SCENE is a Gaussian sequence whose frames are one group, such as `tools.make_wide_scene` writes. It is encoded as one
package and in tiles, both with the quantiser steps, levels and key tiers that one calibration finds. The sequence is
played over and over, as if every time were new, by viewers who walk through the viewing region at a pace that varies,
in a rung that stays, over links of so many times its rate (of the one package) and over a trace scaled so that it
carries as much in that time.
What was on the screen is drawn again from the session's log and compared with the original: `--ticks` pictures of
each segment, 0: none. "held out" is a viewer by whom no constant was chosen. FOLDER keeps the packages, which are not
made again, and a JSON file with all figures.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from airgs_codec._settings import about
from airgs_codec.cli.common import Bar, run_command
from airgs_codec.encoder.calibration.calibrate import calibrate
from airgs_codec.encoder.publish import encode
from airgs_codec.encoder.settings import EncodeSettings
from airgs_codec.encoder.survey import GroupSpan, survey_group
from airgs_codec.encoder.views import plan_views
from airgs_codec.package.store import Package, open_package
from airgs_codec.play.link import Link
from airgs_codec.play.session import SessionLog
from airgs_codec.play.settings import SessionSettings
from airgs_codec.play.trace import open_trace
from airgs_codec.progress import Progress
from airgs_codec.scene.sequence import GaussianSequence, open_sequence
from tools.tiles.runs import AMPLE, BY_VIEW, TILED, WHOLE, Bench, Row, add_savings, links_of, row_of
from tools.tiles.screen import Screen
from tools.tiles.viewer import HELD_OUT, VIEWERS, Watcher

AMPLE_MBPS = "const:1000"


def main(words: Sequence[str] | None = None) -> int:
    """Run it; the exit status."""
    args = _parser().parse_args(words)

    def run() -> int:
        bar = Bar()
        sequence = open_sequence(args.scene)
        whole, tiled = packages(sequence, args, bar)
        seconds = whole.manifest.frames / float(whole.manifest.fps)
        settings = SessionSettings(loops=max(1, round(args.seconds / seconds)), view_buffer_s=args.view_buffer)
        bench, rows = Bench(whole, tiled, settings), []
        for name in args.viewers:
            rows += viewer_rows(sequence, bench, name, args, bar)
            print("\n".join(lines([row for row in rows if row["viewer"] == name])), flush=True)
        place = args.output / f"figures-{args.segment:g}-{args.tiles}-{args.view_buffer:g}.json"
        place.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
        bar.close()
        return 0

    return run_command("bench_tiles", run)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", type=Path)
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--tiles", type=int, default=8)
    parser.add_argument("--segment", type=float, default=0.5, metavar="S", help="seconds of a segment (default: 0.5)")
    parser.add_argument("--seconds", type=float, default=12.0, help="of play (default: 12)")
    parser.add_argument("--viewers", nargs="+", choices=[*VIEWERS, HELD_OUT], default=list(VIEWERS))
    parser.add_argument("--rungs", nargs="+", type=int, default=[1], help="levels that are played (default: 1)")
    parser.add_argument("--times", nargs="+", type=float, default=[1.2, 2.0, 4.0], help="links (default: 1.2 2 4)")
    parser.add_argument("--trace", help="as airgs-play takes it")
    default = SessionSettings().view_buffer_s
    words = f"{about(SessionSettings, 'view_buffer_s')} (default: {default:g})"
    parser.add_argument("--view-buffer", type=float, default=default, metavar="S", help=words)
    parser.add_argument("--ticks", type=int, default=2, help="pictures of each segment (default: 2)")
    parser.add_argument("--keep-all", action="store_true", help="write all rows, so that tiles have those of the whole")
    return parser


def packages(sequence: GaussianSequence, args: argparse.Namespace, progress: Progress) -> tuple[Package, Package]:
    """The scene as one package and in tiles, with the same settings and viewing region."""
    paths = {tiles: args.output / f"{args.segment:g}-{tiles}" for tiles in (1, args.tiles)}
    missing = [tiles for tiles, path in paths.items() if not (path / "airgs.json").is_file()]
    if missing:
        settings = EncodeSettings(
            segment_s=args.segment,
            group_frames=len(sequence),
            keep_all=args.keep_all,
            keys="apart",
            rows="keep",
            measure_pictures=0,
        )
        views = plan_views(sequence, settings)
        progress("calibration", 0, 1)
        survey = survey_group(sequence, GroupSpan(0, 0, len(sequence)), views)
        settings = replace(calibrate(sequence, survey, settings).apply(settings), region=views.region)
        for tiles in missing:
            encode(sequence, paths[tiles], replace(settings, tiles=tiles))
    whole, tiled = (open_package(path) for path in paths.values())
    return whole, tiled


def viewer_rows(
    sequence: GaussianSequence, bench: Bench, name: str, args: argparse.Namespace, progress: Progress
) -> list[Row]:
    """The rows of a viewer: one package in every rung, which others are compared with, then every link."""
    view = Watcher.of(bench.whole.manifest.region, name)
    originals: dict = {}
    screens = {
        how: Screen(sequence, package, view, args.ticks, originals)
        for how, package in ((WHOLE, bench.whole), (TILED, bench.tiled))
    }
    known = {"viewer": name, "turning": view.turning(args.seconds)}
    rows: list[Row] = []

    def note(link: str, how: str, level: int, log: SessionLog) -> None:
        progress(f"{name}, {link}", len(rows), 0)
        row = known | row_of(link, how, level, log)
        if args.ticks:
            seen = screens[WHOLE if how == WHOLE else TILED].look(log)
            row |= {"psnr": seen.psnr, "worst_psnr": seen.worst_psnr}
        rows.append(row)

    ample = {AMPLE: Link(open_trace(AMPLE_MBPS), 0.0)}
    edges: dict[str, SessionLog] = {}
    for level in range(len(bench.whole.manifest.levels)):
        for link, how, log in bench.sessions(level, ample, view):
            if how == WHOLE or level in args.rungs:
                note(link, how, level, log)
            if how != BY_VIEW and level == args.rungs[0]:
                edges[how] = log
    for level in args.rungs:
        links = links_of(bench.rate_bps(level), args.times, args.trace, args.seconds)
        for link, how, log in bench.sessions(level, links, view):
            note(link, how, level, log)
    if args.ticks:
        add_savings(rows)
        rows += border_rows(screens, edges, known | {"link": AMPLE, "rung": args.rungs[0]})
    return rows


def border_rows(screens: dict[str, Screen], logs: dict[str, SessionLog], known: Row) -> list[Row]:
    """PSNR at borders of tiles and elsewhere, of one package and of all tiles."""
    masks = screens[TILED].masks(logs[TILED])
    found = []
    for how, screen in screens.items():
        at, elsewhere = screen.at_borders(logs[how], masks)
        words = {"how": f"{how}, at borders and elsewhere"}
        found.append(known | words | {"border_psnr": at.psnr, "elsewhere_psnr": elsewhere.psnr})
    return found


def lines(rows: Sequence[Row]) -> list[str]:
    """The table for people."""
    first = rows[0]
    found = [f"{first['viewer']}: turns at {first['turning']:.0f} degrees a second, 95th percentile"]
    for row in rows:
        words = f"{row['link']:<20}{row['how']:<14}{row['rung']:>2}"
        if "border_psnr" in row:
            found.append(f"{words}  {row['border_psnr']:.2f}, {row['elsewhere_psnr']:.2f} dB")
            continue
        words += f"{row['bytes'] / row['seconds'] / 1e3:>9.1f} kB/s  stalls {row['stalls']}, {row['stall_s']:.2f} s"
        if "psnr" in row:
            saved = "" if row["saved"] is None else f"  saved {100 * row['saved']:.1f} %"
            words += f"  {row['psnr']:.2f} dB, worst {row['worst_psnr']:.2f}{saved}"
        if "fetched" in row:
            words += f"  fetched {100 * row['fetched']:.0f} %, late {row['late']}, lacking {row['missing_s']:.2f} s"
            words += f", repairs {100 * row['repaired']:.0f} %, wasted {100 * row['wasted']:.1f} %"
        found.append(words)
    return found


if __name__ == "__main__":
    sys.exit(main())
