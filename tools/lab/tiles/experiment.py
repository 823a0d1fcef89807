"""What spatial tiles cost and save: sessions over a scene as one package, in tiles, and in tiles fetched by view.

The first frames of a sequence, one group, are played as they are, a narrow scene, and in copies in a ring about the
viewer, a wide one, which is made in the folder. Each is encoded as one package and in tiles, both with the quantiser
steps, levels and key tiers that one calibration finds; the packages stay in the folder. It is played over and over, as
if every time were new, by viewers who walk through the viewing region at a pace that varies, in a rung that stays, over
links of so many times its rate (of the one package) and over a trace scaled so that it carries as much in that time.
What was on the screen is drawn again from the session's log and compared with the original. "held out" is a viewer by
whom no constant was chosen.
"""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from airgs_codec._settings import about
from airgs_codec.encoder.calibrate import calibrate
from airgs_codec.encoder.publish import encode
from airgs_codec.encoder.settings import EncodeSettings
from airgs_codec.encoder.survey import GroupSpan, plan_views, survey_group
from airgs_codec.jobs.job import code_digest
from airgs_codec.package.package import Package, open_package
from airgs_codec.play.session import SessionLog
from airgs_codec.play.settings import SessionSettings
from airgs_codec.play.trace import Link, Trace
from airgs_codec.progress import Progress
from airgs_codec.scene.sequence import GaussianSequence, open_sequence
from tools.lab import Lab, Page, Row, Section, Table, expect_names, listed, required, setting
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
from tools.make_wide_scene import make_scene

AMPLE_MBPS = "const:1000"
NARROW = "as it is"
HOWS = (TILED, BY_VIEW)
COLUMNS = {
    "scene": ("scene", ""), "link": ("link", ""), "least": ("saved", ".0%"), "most": ("to", ".0%"),
    "lacking_s": ("lacking, s", ".2f"), "stall_s": ("waiting, s", ".2f"), "tiled_s": ("with all tiles", ".2f"),
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Options:
    """What is played."""

    scene: Path = required("a sequence")
    frames: int = setting(12, "of it, one group")
    copies: int = setting(8, "in the ring; 1: no ring")
    tiles: int = setting(8, "of the ring")
    few_tiles: int = setting(4, "of the scene as it is")
    segment: float = setting(0.5, "seconds of a segment")
    seconds: float = setting(12.0, "of play")
    viewers: tuple[str, ...] = setting((*VIEWERS, HELD_OUT), "how they turn")
    rungs: tuple[int, ...] = setting((1,), "levels that are played")
    times: tuple[float, ...] = setting((1.2, 4.0), "rates of links")
    trace: str | None = setting(None, "as airgs-play takes it")
    view_buffer: float = setting(SessionSettings().view_buffer_s, about(SessionSettings, "view_buffer_s"))
    ticks: int = setting(2, "pictures of each segment, 0: none")


def run(options: Options, lab: Lab) -> Page:
    """Every viewer over every link, scene by scene."""
    expect_names("--viewers", options.viewers, (*VIEWERS, HELD_OUT))
    rows: list[Row] = []
    for name, sequence in scenes(options, lab.folder).items():
        whole, tiled = packages(sequence, name, options, lab)
        loops = max(1, round(options.seconds * float(whole.manifest.fps) / whole.manifest.frames))
        bench = Bench(whole, tiled, SessionSettings(loops=loops, view_buffer_s=options.view_buffer))
        for viewer in options.viewers:
            rows += [{"scene": name, **row} for row in viewer_rows(sequence, bench, viewer, options, lab.progress)]
    return page(options, rows)


def scenes(options: Options, folder: Path) -> dict[str, GaussianSequence]:
    """The narrow scene, and the wide one where there are copies."""
    whole = open_sequence(options.scene)
    parts = whole.paths[: options.frames], whole.headers[: options.frames]
    found = {NARROW: replace(whole, paths=parts[0], headers=parts[1], keyframes=(0,))}
    if options.copies > 1:
        ring = folder / f"ring-{options.copies}"
        if not (ring / "transforms.json").is_file():  # what is written last
            shutil.rmtree(ring, ignore_errors=True)
            make_scene(whole, ring, (0, options.frames), options.copies, 2 * options.frames)
        found[f"{options.copies} in a ring"] = open_sequence(ring)
    return found


def packages(sequence: GaussianSequence, name: str, options: Options, lab: Lab) -> tuple[Package, Package]:
    """A scene as one package and in tiles, with the same settings and viewing region. All rows are written."""
    start = f"{name.replace(' ', '-')}-{options.segment:g}-{code_digest(encode)[:8]}"
    count = options.few_tiles if name == NARROW else options.tiles
    paths = {tiles: lab.folder / f"{start}-{tiles}.airgs" for tiles in (1, count)}
    missing = [tiles for tiles, path in paths.items() if not path.is_dir()]
    if missing:
        settings = EncodeSettings(
            segment_s=options.segment,
            group_frames=len(sequence),
            keep_all=True,
            keys="apart",
            rows="keep",
            measure_pictures=0,
        )
        views = plan_views(sequence, settings)
        lab.progress("calibration", 0, 1)
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
    known = {"viewer": name, "turning": view.turning(options.seconds)}  # degrees a second, 95th percentile
    rows: list[Row] = []

    def note(link: str, how: str, level: int, log: SessionLog) -> None:
        progress(f"{name}, {link}", len(rows), 0)
        row = known | row_of(link, how, level, log)
        if options.ticks:
            seen = screens[WHOLE if how == WHOLE else TILED].look(log)
            row |= {"psnr": seen.psnr, "worst_psnr": seen.worst_psnr}
        rows.append(row)

    ample = {AMPLE: Link(Trace.open(AMPLE_MBPS), 0.0)}
    for level in range(len(bench.whole.manifest.levels)):
        for link, how, log in bench.sessions(level, ample, view):
            if how == WHOLE or level in options.rungs:
                note(link, how, level, log)
    for level in options.rungs:
        links = links_of(bench.rate_bps(level), options.times, options.trace, options.seconds)
        for link, how, log in bench.sessions(level, links, view):
            note(link, how, level, log)
    if options.ticks:
        add_savings(rows)
    return rows


def page(options: Options, rows: Sequence[Row]) -> Page:
    """What the rows say."""
    links = links_over(rows)
    section = Section(" ".join([saved_words(links), wait_words(links, options.seconds), price_words(rows)]))
    turns = {row["viewer"]: f"{row['viewer']} {row['turning']:.0f}" for row in rows}
    rules, times = SessionSettings(view_buffer_s=options.view_buffer), listed([f"{n:g}" for n in options.times])
    how = (
        f"{options.tiles} tiles of the ring, {options.few_tiles} of the scene as it is, {options.seconds:g} s of play, "
        f"links of {times} times the rate of the rung. Viewers turn at so many degrees a second (95th percentile): "
        f"{listed(list(turns.values()))}. Tiles in sight are fetched with {rules.view_buffer_s:g} s of buffer, all "
        f"tiles with {rules.buffer_s:g} s."
    )
    return Page([section], how, data=[Table("tiles-links", links, COLUMNS), Table("tiles", rows)])


def links_over(rows: Sequence[Row]) -> list[Row]:
    """A row for each scene and link: what viewers save who fetch by view, and how long they lack and wait at most."""
    found = []
    for scene, link in dict.fromkeys((row["scene"], row["link"]) for row in rows if row["link"] != AMPLE):
        of = {
            how: [row for row in rows if (row["scene"], row["link"], row["how"]) == (scene, link, how)] for how in HOWS
        }
        saved = [row["saved"] for row in of[BY_VIEW] if row.get("saved") is not None]
        found.append(
            {"scene": scene, "link": link, "least": min(saved, default=None), "most": max(saved, default=None)}
            | {"lacking_s": max(row["missing_s"] for row in of[BY_VIEW])}
            | {
                "stall_s": max(row["stall_s"] for row in of[BY_VIEW]),
                "tiled_s": max(row["stall_s"] for row in of[TILED]),
            }
        )
    return found


def saved_words(links: Sequence[Row]) -> str:
    """What fetching by view saves at equal quality, scene by scene."""
    parts = []
    for scene in dict.fromkeys(row["scene"] for row in links):
        shares = [
            row[key] for row in links if row["scene"] == scene for key in ("least", "most") if row[key] is not None
        ]
        parts.append(f"{span_words(shares)} ({scene})")
    return f"At equal PSNR of what is seen, fetching the tiles in sight {listed(parts)}."


def span_words(shares: Sequence[float]) -> str:
    """What these shares of the bytes mean that are saved."""
    if not shares:
        return "is not comparable"
    least, most = 100 * min(shares), 100 * max(shares)
    if least >= 1:
        return f"saves {between(least, most)} % of the bytes"
    if most <= -1:
        return f"takes {between(-most, -least)} % more"
    return f"saves nothing for sure, {between(least, most)} % of the bytes"


def between(least: float, most: float) -> str:
    """Both numbers without digits, or one where they are the same."""
    return " to ".join(dict.fromkeys((f"{least:.0f}", f"{most:.0f}")))


def wait_words(links: Sequence[Row], seconds: float) -> str:
    """What that costs in quality and waiting, at most."""
    lacking, still, tiled = (max(row[key] for row in links) for key in ("lacking_s", "stall_s", "tiled_s"))
    return (
        f"Of {seconds:g} s something in sight is lacking for {lacking:.2f} s at most, and the picture stands still for "
        f"{still:.2f} s, {tiled:.2f} s where all tiles are fetched."
    )


def price_words(rows: Sequence[Row]) -> str:
    """What fetching all tiles takes more than one package does."""
    parts = []
    for scene in dict.fromkeys(row["scene"] for row in rows):
        more = [
            -100 * row["saved"]
            for row in rows
            if row["scene"] == scene and row["how"] == TILED and row.get("saved") is not None
        ]
        if more:
            parts.append(f"{between(min(more), max(more))} % ({scene})")
    return f"All tiles take more bytes than one package: {listed(parts)}." if parts else ""
