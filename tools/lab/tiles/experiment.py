"""What spatial tiles cost and save: sessions over a scene as one package, in tiles, and in tiles fetched by view.

The scene is a sequence whose frames are one group, such as tools/make_wide_scene.py writes. It is encoded as one
package and in tiles, both with the quantiser steps, levels and key tiers that one calibration finds; the packages stay
in the folder. The sequence is played over and over, as if every time were new, by viewers who walk through the viewing
region at a pace that varies, in a rung that stays, over links of so many times its rate (of the one package) and over a
trace scaled so that it carries as much in that time. What was on the screen is drawn again from the session's log and
compared with the original. "held out" is a viewer by whom no constant was chosen.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from airgs_codec._settings import about
from airgs_codec.encoder.calibrate import calibrate
from airgs_codec.encoder.publish import encode
from airgs_codec.encoder.settings import EncodeSettings
from airgs_codec.encoder.survey import GroupSpan, plan_views, survey_group
from airgs_codec.package.package import Package, open_package
from airgs_codec.play.session import SessionLog
from airgs_codec.play.settings import SessionSettings
from airgs_codec.play.trace import Link, Trace
from airgs_codec.progress import Progress, silent
from airgs_codec.scene.sequence import GaussianSequence, open_sequence
from tools.lab import Lab, Page, Row, Section, Table, expect_names, required, setting
from tools.lab.tiles.runs import (
    AMPLE,
    BY_VIEW,
    HELD_OUT,
    TILED,
    VIEWERS,
    WHOLE,
    Bench,
    Watcher,
    add_savings,
    links_of,
    row_of,
)
from tools.lab.tiles.screen import Screen

AMPLE_MBPS = "const:1000"
COLUMNS = {
    "viewer": ("viewer", ""), "link": ("link", ""), "how": ("fetches", ""), "rung": ("rung", "d"),
    "kb_s": ("kB/s", ".1f"), "stalls": ("stalls", "d"), "stall_s": ("s", ".2f"), "psnr": ("PSNR, dB", ".2f"),
    "worst_psnr": ("worst", ".2f"), "saved": ("saved", ".1%"), "fetched": ("fetched", ".0%"), "late": ("late", "d"),
    "missing_s": ("lacking, s", ".2f"), "repaired": ("repairs", ".0%"), "wasted": ("wasted", ".1%"),
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Options:
    """What is played."""

    scene: Path = required("a sequence of one group")
    tiles: int = setting(8, "how many")
    segment: float = setting(0.5, "seconds of a segment")
    seconds: float = setting(12.0, "of play")
    viewers: tuple[str, ...] = setting(tuple(VIEWERS), f"of {', '.join(VIEWERS)}, {HELD_OUT}")
    rungs: tuple[int, ...] = setting((1,), "levels that are played")
    times: tuple[float, ...] = setting((1.2, 2.0, 4.0), "rates of links")
    trace: str | None = setting(None, "as airgs-play takes it")
    view_buffer: float = setting(SessionSettings().view_buffer_s, about(SessionSettings, "view_buffer_s"))
    ticks: int = setting(2, "pictures of each segment, 0: none")
    keep_all: bool = setting(False, "write all rows, so that tiles have those of the whole")


def run(options: Options, lab: Lab) -> Page:
    """Every viewer over every link."""
    expect_names("--viewers", options.viewers, (*VIEWERS, HELD_OUT))
    sequence = open_sequence(options.scene)
    whole, tiled = packages(sequence, options, lab.folder, lab.progress)
    seconds = whole.manifest.frames / float(whole.manifest.fps)
    loops = max(1, round(options.seconds / seconds))
    bench = Bench(whole, tiled, SessionSettings(loops=loops, view_buffer_s=options.view_buffer))
    rows = [row for name in options.viewers for row in viewer_rows(sequence, bench, name, options, lab.progress)]
    played, borders = ([row for row in rows if ("border_psnr" in row) == at] for at in (False, True))
    for row in played:
        row["kb_s"] = row["bytes"] / row["seconds"] / 1e3
    turns = {row["viewer"]: f"{row['viewer']} turns at {row['turning']:.0f} degrees a second" for row in rows}
    answer = f"{', '.join(turns.values())} (95th percentile)."
    return Page([Section(answer, tables=[Table("tiles", played, COLUMNS), Table("tiles-borders", borders)])])


def packages(
    sequence: GaussianSequence, options: Options, folder: Path, progress: Progress = silent
) -> tuple[Package, Package]:
    """The scene as one package and in tiles, with the same settings and viewing region."""
    paths = {tiles: folder / f"{options.segment:g}-{tiles}" for tiles in (1, options.tiles)}
    missing = [tiles for tiles, path in paths.items() if not (path / "airgs.json").is_file()]
    if missing:
        settings = EncodeSettings(
            segment_s=options.segment,
            group_frames=len(sequence),
            keep_all=options.keep_all,
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


def viewer_rows(sequence: GaussianSequence, bench: Bench, name: str, options: Options, progress: Progress) -> list[Row]:
    """The rows of a viewer: one package in every rung, which others are compared with, then every link."""
    view = Watcher.of(bench.whole.manifest.region, name)
    originals: dict = {}
    screens = {
        how: Screen(sequence, package, view, options.ticks, originals)
        for how, package in ((WHOLE, bench.whole), (TILED, bench.tiled))
    }
    known = {"viewer": name, "turning": view.turning(options.seconds)}
    rows: list[Row] = []

    def note(link: str, how: str, level: int, log: SessionLog) -> None:
        progress(f"{name}, {link}", len(rows), 0)
        row = known | row_of(link, how, level, log)
        if options.ticks:
            seen = screens[WHOLE if how == WHOLE else TILED].look(log)
            row |= {"psnr": seen.psnr, "worst_psnr": seen.worst_psnr}
        rows.append(row)

    ample = {AMPLE: Link(Trace.open(AMPLE_MBPS), 0.0)}
    edges: dict[str, SessionLog] = {}
    for level in range(len(bench.whole.manifest.levels)):
        for link, how, log in bench.sessions(level, ample, view):
            if how == WHOLE or level in options.rungs:
                note(link, how, level, log)
            if how != BY_VIEW and level == options.rungs[0]:
                edges[how] = log
    for level in options.rungs:
        links = links_of(bench.rate_bps(level), options.times, options.trace, options.seconds)
        for link, how, log in bench.sessions(level, links, view):
            note(link, how, level, log)
    if options.ticks:
        add_savings(rows)
        rows += border_rows(screens, edges, known | {"link": AMPLE, "rung": options.rungs[0]})
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
