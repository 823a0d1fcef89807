"""The page of an encode: how near the package is to the frames that were given, and what took the time."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

from airgs_codec._report import Page, PagePicture, Table, answered
from airgs_codec.encoder.publish import EncodeReport
from airgs_codec.encoder.settings import EncodeSettings
from airgs_codec.inspect.compare import compare_two, open_side, shared_views, side_by_side
from airgs_codec.inspect.summary import plot_rungs, rung_table, summarise
from airgs_codec.media.image import write_png
from airgs_codec.package.package import Package
from airgs_codec.play.report import beaten_words
from airgs_codec.progress import Progress, silent
from airgs_codec.scene.camera import resized
from airgs_codec.scene.sequence import GaussianSequence

REPORT_VIEWS = 4  # of each frame
REPORT_PIXELS = 200_000  # of a picture, at most
MUCH = 0.4  # share of the time above which less of a stage may do
UNEVEN_DB = 3.0  # under the mean from which a picture is named as a fault
UNSURE_DB = 0.5  # of a claim, from which more pictures should measure


def write_report(
    folder: Path, given: GaussianSequence, package: Package, done: EncodeReport, progress: Progress = silent
) -> Path:
    """Write index.html with the answer, a chart and the lowest picture, and give its path.

    `given`: what was encoded, as it came. Raises ConfigError when they cannot be written.
    """
    a, b, m = open_side(given, name="given"), open_side(package, name="encoded"), package.manifest
    words, views = shared_views(a, b)
    small = [resized(v, min(1.0, (REPORT_PIXELS / (v.width * v.height)) ** 0.5)) for v in views[:REPORT_VIEWS]]
    result = compare_two(a, b, range(a.frames), small, progress)
    s = summarise(m, done.manifest_bytes)
    top, quality, lowest, sizes = s["rungs"][0], result.quality, result.lowest, s["top_rung_bytes"]
    claim = f", and is measured at {top['psnr']:.1f} dB, good to {top['error']:.1f} dB" if m.measured else ""
    rate = f" a frame, {top['mean_bps'] / 1e6:.2f} Mbit/s" if top["mean_bps"] else ""
    far = ", far below the others" if lowest.psnr < quality.psnr - UNEVEN_DB else ""
    largest = max(sizes, key=lambda kind: sizes[kind])
    on_ladder = {f"{r['keyframe']}+{r['delta']}": r["best"] for r in s["rungs"] if m.measured}
    answer = {
        "good": f"The top rung takes {top['bytes_per_frame'] / 1e3:.1f} kB{rate}{claim}. "
        f"It shows the frames that were given at {quality.psnr:.1f} dB in {words.removesuffix(f' of {a.name}')}.",
        "wrong": f"The lowest picture is of frame {lowest.frame}, with {lowest.psnr:.1f} dB{far}. Most bytes, "
        f"{100 * sizes[largest] / sum(sizes.values()):.0f} %, are {largest}.",
        "useless": beaten_words(on_ladder) or "Nothing.",
        "change": advice(done) or "Nothing.",
    }
    chart, name = "What viewers fetch and see; grey: no player should.", f"frame-{lowest.frame:06d}.png"
    pictures = [
        PagePicture("", chart, lambda figure: plot_rungs(s["rungs"], figure.subplots())),
        PagePicture(name, "The lowest picture.", save=lambda path: write_png(path, side_by_side(a, b, lowest))),
    ]
    stages = {
        "about": ("part of the work", ""), "seconds": ("seconds", ".1f"), "chosen": ("what came of it", ""),
        "gained": ("gained", ""),
    }  # fmt: skip
    tables = [
        Table("What took the time", [asdict(stage) for stage in done.stages()], stages),
        rung_table(s["rungs"]),
        Table("What was decided", [{"decision": line} for line in m.decisions]),
    ]
    return Page(answered(answer, pictures, *tables), "What was encoded").write(folder)


def advice(done: EncodeReport) -> str:
    """Return what would make the next encode better or quicker; empty where that is nothing."""
    seconds = {stage.about: stage.seconds for stage in done.stages()}
    share, found = {name: s / max(1e-9, sum(seconds.values())) for name, s in seconds.items()}, []
    rungs, given = done.manifest.rungs, done.plan.settings
    if rungs and rungs[0][0].error > UNSURE_DB and given.measure_pictures < EncodeSettings().measure_pictures:
        found.append("The claim is not sure: more --measure-pictures make it so.")
    elif share["measuring"] > MUCH:
        found.append("Fewer --measure-pictures would be quicker, with a claim less sure.")
    if share.get("steps and pruning levels", 0.0) > MUCH:
        found.append("--calibrate none does without trials, at the price of what they save.")
    if share.get("quality", 0.0) > MUCH and not given.steps.colours:  # a target of colour differences chooses colours
        found.append(f"The next encode of this scene need not search: --quality {given.quality:.4g} is what was found.")
    return " ".join(found)
