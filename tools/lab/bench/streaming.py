"""What viewers get of scenes over measured links: quality on the screen, waiting, and what no player could have beaten.

Every policy plays every scene, encoded by default, over every trace from seeded starts. Figures are means over sessions
on links that carry the smallest rungs without a stall; on others every policy waits. Regret is how far PSNR is below
the bound for the same moments, which knows the whole link. `paper` has the cliff test of the paper, `paper-no-cliff` is
the same without.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from airgs_codec.package.manifest import Manifest
from airgs_codec.package.package import open_package
from airgs_codec.play.offers import Offers
from airgs_codec.play.playout import SessionSettings
from airgs_codec.play.policies import DEFAULT_POLICY
from airgs_codec.play.study import Study, StudySettings, run_study, summarise
from tools.lab import COLOURS, Lab, Page, PagePicture, Row, Section, Table, content, listed, required, setting
from tools.lab.made import encoded, name_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

CLIFF, NO_CLIFF = "paper", "paper-no-cliff"
BETTER = {"psnr": (1, 0.05), "low": (1, 0.05), "stalled": (-1, 0.0005)}  # figure -> sign, and what is no difference
POLICIES = (DEFAULT_POLICY, "throughput", "bola", CLIFF, NO_CLIFF)
COLUMNS = {
    "scene": ("scene", ""), "policy": ("policy", ""), "psnr": ("PSNR, dB", ".2f"), "low": ("5th percentile", ".2f"),
    "regret": ("regret, dB", ".2f"), "stalled": ("waiting", ".2%"), "stalled_all": ("on all links", ".1%"),
}  # fmt: skip
BRIEF = {
    "policy": ("policy", ""), "psnr": ("PSNR on screen, dB", ".1f"), "stalled": ("waiting", ".1%"),
    "regret": ("below the best possible, dB", ".1f"),
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Options:
    traces: Path = required("a folder of traces")
    scenes: tuple[str, ...] = required("scenes or packages, SCENE[=VIEWS]")
    policies: tuple[str, ...] = setting(POLICIES, "what chooses rungs")
    starts: int = setting(8, "in each trace")
    seconds: float = setting(30.0, "of play")
    jobs: int = setting(2, "processes")


def run(options: Options, lab: Lab) -> Page:
    traces = tuple(str(path) for path in sorted(options.traces.iterdir()) if path.is_file())
    rows: list[Row] = []
    reads = [content(Path(path)) for path in traces]
    for scene in options.scenes:
        package = encoded(scene, lab.folder)
        settings = settings_of(options, traces, Offers.of(open_package(package)).duration_s)
        study = partial(run_study, package, settings, lab.progress)
        rows += rows_of(name_of(scene), package, lab.results.once("study", [settings, content(package), reads], study))
    return page(options, rows)


def settings_of(options: Options, traces: tuple[str, ...], duration_s: float) -> StudySettings:
    """How a scene of so many seconds is played."""
    session = SessionSettings(loops=max(1, round(options.seconds / duration_s)))
    return StudySettings(options.policies, traces, options.starts, session=session, jobs=options.jobs)


def rows_of(scene: str, package: Path, study: Study) -> list[Row]:
    rates = rung_mbps(open_package(package).manifest)
    means = [row["mean_bps"] / 1e6 for row in study.rows]
    known = {"scene": scene, "least_mbps": min(rates), "most_mbps": max(rates), "rtt_ms": 1e3 * study.rows[0]["rtt_s"]}
    known |= {"slowest_mbps": min(means), "fastest_mbps": max(means)}
    rows = []
    for everywhere, here in zip(summarise(study), summarise(study, True), strict=True):
        figures = here["figures"]
        psnr, stalled = figures["psnr_mean"], figures["stall_ratio"]
        rows.append(
            known
            | {"policy": here["policy"], "sessions": here["sessions"], "of": everywhere["sessions"]}
            | {"psnr": psnr.mean, "psnr_from": psnr.low, "psnr_to": psnr.high}
            | {"stalled": stalled.mean, "stalled_from": stalled.low, "stalled_to": stalled.high}
            | {"low": figures["psnr_p5"].mean, "regret": figures["regret"].mean}
            | {"stalled_all": everywhere["figures"]["stall_ratio"].mean}
        )
    return rows


def rung_mbps(m: Manifest) -> list[float]:
    sizes = [m.bytes_of(m.rung_files(q, j)) for q in range(len(m.qualities)) for j in range(len(m.levels))]
    return [8e-6 * size / (m.frames / float(m.fps)) for size in sizes]


def page(options: Options, rows: Sequence[Row]) -> Page:
    scenes = dict.fromkeys(row["scene"] for row in rows)
    words = [default_words(rows), best_words(rows), cliff_words(rows)]
    caption = "PSNR over waiting, means and their intervals over traces"
    picture = PagePicture("streaming", caption, partial(draw, rows), (4 * len(scenes), 3.2))
    section = Section(" ".join(filter(None, words)), pictures=[picture], tables=[Table("streaming", rows, COLUMNS)])
    first = [row for row in rows if row["scene"] == rows[0]["scene"]]
    return Page([section], how_of(options, rows), brief=[Table("brief", first, BRIEF)])


def how_of(options: Options, rows: Sequence[Row]) -> str:
    first, rules = rows[0], SessionSettings()
    scenes = list({row["scene"]: row for row in rows}.values())
    rates = [f"{row['scene']} ({row['least_mbps']:.1f} to {row['most_mbps']:.1f} Mbit/s)" for row in scenes]
    links = [f"{row['sessions']} of {row['of']} ({row['scene']})" for row in scenes]
    return (
        f"Played: {listed(rates)}, {options.seconds:g} s, over {first['of'] // options.starts} traces of "
        f"{first['slowest_mbps']:.1f} to {first['fastest_mbps']:.1f} Mbit/s on average, from {options.starts} seeded "
        f"starts in each; {first['rtt_ms']:.0f} ms round trip, {rules.buffer_s:g} s of buffer. Figures are of the "
        f"links that carry the smallest rungs without a stall, {listed(links)}."
    )


def default_words(rows: Sequence[Row]) -> str:
    first, *others = (row for row in rows if row["policy"] == rows[0]["policy"])
    words = (
        f"With {first['policy']}, {first['scene']} has {first['psnr']:.1f} dB on the screen, {first['regret']:.1f} dB "
        f"below the best that any player could show, and waits {100 * first['stalled']:.1f} % of the time"
    )
    more = [
        f"{row['scene']} has {row['psnr']:.1f} dB, {row['regret']:.1f} dB below, and waits {100 * row['stalled']:.1f} %"
        for row in others
    ]
    return f"{'; '.join([words, *more])}."


def best_words(rows: Sequence[Row]) -> str:
    """Which policies are better than the first one in some of BETTER, and worse in none."""
    first = {row["scene"]: row for row in rows if row["policy"] == rows[0]["policy"]}
    gains = [
        (row, [sign * (row[name] - first[row["scene"]][name]) / same for name, (sign, same) in BETTER.items()])
        for row in rows
    ]
    better = [f"{row['policy']} ({row['scene']})" for row, gain in gains if max(gain) > 1 and min(gain) >= -1]
    figures = "PSNR, its 5th percentile and waiting"
    if not better:
        return f"No other policy is better in some of {figures} and worse in none."
    return f"Better in some of {figures}, and worse in none, is {listed(better)}."


def cliff_words(rows: Sequence[Row]) -> str:
    """What the cliff test costs and brings; '' where it was not played."""
    by = {(row["scene"], row["policy"]): row for row in rows}
    parts = []
    for scene in (scene for scene, policy in by if policy == CLIFF and (scene, NO_CLIFF) in by):
        with_it, without = by[scene, CLIFF], by[scene, NO_CLIFF]
        share = 100 * (with_it["stalled"] - without["stalled"]) / without["stalled"] if without["stalled"] else 0.0
        more = with_it["psnr"] - without["psnr"]
        waits = f"{abs(share):.0f} % {'longer' if share > 0 else 'shorter'}" if abs(share) >= 0.5 else "as long"
        psnr = f"{abs(more):.2f} dB {'more' if more > 0 else 'less'}" if abs(more) >= 0.005 else "the same PSNR"
        same = (waits, psnr) == ("as long", "the same PSNR")
        parts.append(f"as long as without ({scene})" if same else f"{waits} for {psnr} ({scene})")
    return f"With the cliff test of the paper, viewers wait {listed(parts)}." if parts else ""


def draw(rows: Sequence[Row], figure: Figure) -> None:
    scenes, policies = (list(dict.fromkeys(row[name] for row in rows)) for name in ("scene", "policy"))
    for axes, scene in zip(figure.subplots(1, len(scenes), squeeze=False)[0], scenes, strict=True):
        for row in (row for row in rows if row["scene"] == scene):
            spans = {
                axis: [
                    [max(0, scale * (row[name] - row[f"{name}_from"]))],
                    [max(0, scale * (row[f"{name}_to"] - row[name]))],
                ]
                for axis, name, scale in (("xerr", "stalled", 100), ("yerr", "psnr", 1))
            }
            colour = COLOURS[policies.index(row["policy"])]
            axes.errorbar(100 * row["stalled"], row["psnr"], fmt="o", color=colour, label=row["policy"], **spans)
        axes.set(title=scene, xlabel="waiting, % of the time", ylabel="PSNR on the screen, dB", xlim=(0, None))
    figure.axes[0].legend(loc="lower right")
