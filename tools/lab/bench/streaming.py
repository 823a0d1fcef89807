"""What viewers get of scenes over measured links: PSNR on the screen, waiting, and what no player could have beaten.

Every policy plays every scene, encoded by default, over all traces of each set from seeded starts. Policies are ranked
by QoE, which counts waiting (`airgs_codec.play.metrics`), paired on the same links. Regret is how far PSNR is below the
bound for the same moments, which knows the whole link. V³ is its layout of the same groups at three QPs, of which its
viewers take one for each group.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from airgs_codec.media.metrics import psnr
from airgs_codec.package.layout import delta_media_path
from airgs_codec.package.manifest import rungs_of
from airgs_codec.package.package import Package, open_package
from airgs_codec.package.region import draw_views
from airgs_codec.play.metrics import FIGURES
from airgs_codec.play.offers import Offers, RungOffer, SegmentOffer
from airgs_codec.play.playout import SessionSettings
from airgs_codec.play.policies import DEFAULT_POLICY
from airgs_codec.play.study import StudySettings, interval, sessions
from airgs_codec.scene.sequence import GaussianSequence, open_sequence
from tools.lab import COLOURS, Lab, Page, PagePicture, Row, Section, Table, content, listed, required, setting
from tools.lab.made import encoded, name_of
from tools.lab.numerics.rows import picture_error
from tools.lab.paired import difference
from tools.lab.rd.layouts import V3_FORMS, v3_layout

if TYPE_CHECKING:
    from matplotlib.figure import Figure

POLICIES = (DEFAULT_POLICY, "throughput", "bola", "paper", "paper-no-cliff", "fixed:0")
V3, V3_POLICIES, QPS = "V³, ", (DEFAULT_POLICY,), (10, 22, 46)
COLUMNS = {
    "scene": ("scene", ""), "links": ("links", ""), "policy": ("policy", ""), "psnr": ("PSNR, dB", ".1f"),
    "stalled": ("waiting", ".1%"), "verdict": ("QoE beside the first, 95 %", ""), "low": ("5th percentile", ".1f"),
    "regret": ("regret, dB", ".2f"),
}  # fmt: skip
VIEWS, FRAMES, SEED = 4, 4, 1000  # of pictures of a group that judge V³; the package has its own
Coded = list[list[tuple[int, float]]]  # bytes and PSNR of each group at each QP


@dataclass(frozen=True, slots=True)
class Options:
    scenes: tuple[str, ...] = required("scenes or packages, SCENE[=VIEWS]")
    links: tuple[str, ...] = setting(("LTE=tests/data/fox/trace.csv",), "NAME=FOLDER[@FACTOR on its rates]")
    policies: tuple[str, ...] = setting(POLICIES, "what chooses rungs, the default one first")
    starts: int = setting(2, "in each trace")
    seconds: float = setting(30.0, "of play")


class Videos(Offers):
    """The same groups as V³ has them: a segment is all of its group at one of QPS, and nothing else is fetched."""

    def __init__(self, like: Offers, coded: Coded) -> None:
        self._sizes = {
            delta_media_path(j, s): size for s, group in enumerate(coded) for j, (size, _) in enumerate(group)
        }
        self._coded = coded
        super().__init__(like.manifest)

    def _offer(self, segment: int, budget: int | None = None) -> SegmentOffer:
        like, rungs = super()._offer(segment, budget), []
        for j, (size, shown) in enumerate(self._coded[segment]):
            path, saved = delta_media_path(j, segment), 1 - size / self._coded[segment][0][0]
            wire = size + self.header_bytes
            rungs.append(RungOffer(0, j, shown, np.nan, like.rungs[0].gaussians, True, saved, (), (path,), wire))
        return SegmentOffer(segment, like.seconds, like.group, None, like.starts_group, tuple(rungs))

    def file_bytes(self, path: str) -> int:
        return self._sizes.get(path, 0)


def code_v3(package: Package, sequence: GaussianSequence) -> Coded:
    """The segments of a package in V³'s layout, each in that of its two forms that shows more at the middle QP."""
    m, cameras, coded = package.manifest, draw_views(package.manifest.region, VIEWS, SEED), []
    for segment in m.segments:
        frames = sequence.load(range(segment.start, segment.stop)).frames
        judged = sorted({round(i) for i in np.linspace(0, len(frames) - 1, FRAMES)})
        forms = []
        for form in V3_FORMS:
            groups = [v3_layout(frames, qp, "veryslow", form) for qp in QPS]
            errors = [
                np.mean([picture_error(g.frames[i], frames[i], camera) for i in judged for camera in cameras])
                for g in groups
            ]
            forms.append([(g.bytes, psnr(float(error))) for g, error in zip(groups, errors, strict=True)])
        coded.append(max(forms, key=lambda form: form[1][1]))
    return coded


def run(options: Options, lab: Lab) -> Page:
    rows: list[Row] = []
    rungs: list[Row] = []
    for scene in options.scenes:
        place, _, views = scene.partition("=")
        path = encoded(scene, lab.folder)
        package, played = open_package(path), {"": (Offers.of(open_package(path)), options.policies)}
        rungs += [
            {"scene": name_of(scene), "rung": "airgs"} | dict(zip(("mbps", "psnr"), r, strict=True))
            for r in rates_of(package)
        ]
        if path != Path(place):
            make = partial(code_v3, package, open_sequence(place, views=views or None))
            coded = lab.results.once("videos", [content(path), content(Path(place)), QPS], make)
            played[V3] = Videos(played[""][0], coded), V3_POLICIES
            seconds = package.manifest.frames / float(package.manifest.fps)
            for j, qp in enumerate(QPS):
                mbps = 8e-6 * sum(group[j][0] for group in coded) / seconds
                shown = float(np.mean([group[j][1] for group in coded]))
                rungs.append({"scene": name_of(scene), "rung": f"V³, QP {qp}", "mbps": mbps, "psnr": shown})
        for links in options.links:
            found = []
            for form, (offers, policies) in played.items():
                settings = settings_of(options, links, policies, offers.duration_s)
                reads = [form, settings, content(path), [content(Path(trace)) for trace in settings.traces]]
                one = lab.results.once("links", reads, partial(play, offers, settings, lab))
                found += [row | {"policy": form + row["policy"]} for row in one]
            rows += summary(name_of(scene), links.partition("=")[0], found)
    return page(options, rows, rungs)


def settings_of(options: Options, links: str, policies: tuple[str, ...], duration_s: float) -> StudySettings:
    place, _, factor = links.partition("=")[2].partition("@")
    files = sorted(p for p in Path(place).iterdir() if p.is_file()) if Path(place).is_dir() else [Path(place)]
    session = SessionSettings(loops=max(1, round(options.seconds / duration_s)))
    return StudySettings(policies, tuple(map(str, files)), options.starts, float(factor or 1), session=session)


def play(offers: Offers, settings: StudySettings, lab: Lab) -> list[Row]:
    rows: list[Row] = []
    for done, path in enumerate(settings.traces):
        lab.progress("sessions", done, len(settings.traces))
        more = sessions(offers, path, settings)
        keep = ("trace", "policy", "feasible", "mean_bps", "rtt_s", *FIGURES[:8], "qoe")
        rows += [{name: row[name] for name in keep} for row in more]
    return rows


def summary(scene: str, links: str, played: Sequence[Row]) -> list[Row]:
    """A row for each policy: means, their intervals over traces, and what it is worth beside the first one."""
    policies = list(dict.fromkeys(row["policy"] for row in played))
    by = {policy: [row for row in played if row["policy"] == policy] for policy in policies}
    first, rows = by[policies[0]], []
    traces = [row["trace"] for row in first]
    known = {"scene": scene, "links": links, "sessions": len(first), "traces": len(set(traces))}
    known |= {"feasible": float(np.mean([row["feasible"] for row in first]))}
    known |= {f"{name}_mbps": f([row["mean_bps"] for row in first]) / 1e6 for name, f in (("low", min), ("high", max))}
    for policy, some in by.items():
        values = {name: np.array([row[name] for row in some], float) for name in (*FIGURES[:8], "qoe")}
        psnr_db, stalled = (interval(values[name], traces) for name in ("psnr_mean", "stall_ratio"))
        found = difference(values["qoe"].tolist(), [row["qoe"] for row in first], traces)
        rows.append(
            known
            | {"policy": policy, "psnr": psnr_db.mean, "psnr_from": psnr_db.low, "psnr_to": psnr_db.high}
            | {"stalled": stalled.mean, "stalled_from": stalled.low, "stalled_to": stalled.high}
            | {"low": float(values["psnr_p5"].mean()), "regret": float(np.nanmean(values["regret"]))}
            | {"qoe": float(values["qoe"].mean()), "beside": found.mean, "beside_from": found.low}
            | {"beside_to": found.high, "sign": found.sign, "verdict": found.words("dB") if some is not first else ""}
        )
    return rows


def rates_of(package: Package) -> list[tuple[float, float]]:
    """Mbit/s and dB of the rungs of a package's ladder, the best one first."""
    m = package.manifest
    seconds = m.frames / float(m.fps)
    return [(8e-6 * rung.bytes / seconds, rung.psnr or np.nan) for rung in rungs_of(m, 0) if rung.best]


def page(options: Options, rows: Sequence[Row], rungs: Sequence[Row]) -> Page:
    scenes, sets = (list(dict.fromkeys(row[name] for row in rows)) for name in ("scene", "links"))
    caption = "PSNR over waiting, means and their 95 % intervals over traces"
    picture = PagePicture("streaming", caption, partial(draw, rows), (4 * len(sets), 3.2 * len(scenes)))
    section = Section(" ".join(words(rows)), pictures=[picture], tables=[Table("streaming", rows, COLUMNS)])
    return Page([section], how_of(options, rows), data=[Table("streaming-rungs", rungs)])


def how_of(options: Options, rows: Sequence[Row]) -> str:
    sets = {row["links"]: row for row in rows}.values()
    links = [
        f"{r['traces']} of {r['links']} ({r['low_mbps']:.1f} to {r['high_mbps']:.1f} Mbit/s on average)" for r in sets
    ]
    return (
        f"Every policy plays {options.seconds:g} s over the same traces, {listed(links)}, from {options.starts} seeded "
        f"starts in each; {SessionSettings().buffer_s:g} s of buffer. QoE is beside that of {rows[0]['policy']}, "
        "paired, with its 95 % interval over traces."
    )


def words(rows: Sequence[Row]) -> list[str]:
    """What the first policy gives of each scene, and where others are better beyond their error."""
    first, said = rows[0]["policy"], []
    for scene in dict.fromkeys(row["scene"] for row in rows):
        some = [row for row in rows if row["scene"] == scene and row["policy"] == first]
        parts = [f"{r['psnr']:.1f} dB and waits {100 * r['stalled']:.1f} % of the time over {r['links']}" for r in some]
        said.append(f"With {first}, {scene} has {listed(parts)}.")
    better = [f"{r['policy']} ({r['scene']}, {r['links']}: {r['verdict']})" for r in rows if r["sign"] > 0]
    return [
        *said,
        f"Beyond their error better are {listed(better)}." if better else "Nothing is better beyond its error.",
    ]


def draw(rows: Sequence[Row], figure: Figure) -> None:
    scenes, sets, policies = (list(dict.fromkeys(row[name] for row in rows)) for name in ("scene", "links", "policy"))
    axes = figure.subplots(len(scenes), len(sets), squeeze=False)
    for row in rows:
        spans = {
            axis: [[max(0, f * (row[name] - row[f"{name}_from"]))], [max(0, f * (row[f"{name}_to"] - row[name]))]]
            for axis, name, f in (("xerr", "stalled", 100), ("yerr", "psnr", 1))
        }
        axis = axes[scenes.index(row["scene"])][sets.index(row["links"])]
        colour = COLOURS[policies.index(row["policy"])]
        axis.errorbar(100 * row["stalled"], row["psnr"], fmt="o", color=colour, label=row["policy"], **spans)
        axis.set_title(f"{row['scene']}, {row['links']}", fontsize=10)
        axis.set_xscale("symlog", linthresh=1)
        axis.set(xlabel="waiting, % of the time", ylabel="PSNR on the screen, dB", xlim=(-0.2, 100))
        axis.set_xticks([0, 1, 10, 100], ["0", "1", "10", "100"])
    figure.legend(*figure.axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=4, fontsize=8)
