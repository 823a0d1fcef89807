"""Rate and distortion of airgs beside published layouts and formats, over the same rows, views and frames.

PSNR is measured against renderings of the input, pooled over the test cameras and `--frames` frames of the sequence;
where transforms.json names pictures of these cameras and frames, PSNR against them stands beside it. The re-implemented
layouts (tools/lab/rd/layouts.py) run at the preset of x264 and x265 that airgs uses, veryslow, and as their published
scripts call these, V^3's in both forms that it publishes. The other coders are given all rows, in Morton order; "airgs,
keeps all" drops none. Of the variants of a format the one with the fewest bytes counts, at the PSNR of `--at`; a format
that does not reach it is shown at its nearest point. Points that were measured stay measured.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

from airgs_codec.errors import ConfigError
from airgs_codec.render import render
from tools.lab import Lab, Page, PagePicture, Row, Section, Table, plain_log_ticks, rows_of, setting
from tools.lab.rd.coders import OURS, OURS_WHOLE, layout_trials, our_trials
from tools.lab.rd.fourdgs import fourdgs_trials
from tools.lab.rd.programs import splat4d_trials, splat_transform_trials
from tools.lab.rd.subject import Measured, RdPoint, Subject, Trial, bd_rate, curves, kb_at, open_subject, rising
from tools.lab.rd.written import written_trials

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLUMNS = {
    "format": ("format", ""), "kb": ("kB a frame", ".1f"), "psnr": ("PSNR, dB", ".1f"),
    "times": ("times airgs at that PSNR", ".1f"), "variant": ("its variant", ""),
}  # fmt: skip
BRIEF = 5  # formats that pages show, the README too: ours and the nearest


@dataclass(frozen=True, slots=True)
class Options(Measured):
    frames: int = setting(6, "frames measured")
    targets: tuple[float, ...] = setting((47.0, 45.5, 44.0, 42.5, 41.0, 39.5), "PSNR of our packages, dB")
    at: float = setting(43.0, "dB at which bytes are compared")
    only: tuple[str, ...] = setting((), "formats that are measured", default="all")
    splat_transform: str = setting("", "a command such as 'splat-transform -g cpu'")
    splat4d: str = setting("", "the program of the PyPI package splats4d")
    fourdgs: str = setting("", "python of an environment with the PyPI package fourdgs")


def run(options: Options, lab: Lab) -> Page:
    sequence, cameras = options.open()
    subject = open_subject(sequence, cameras, options.frames, options.views)
    chosen = [trial for trial in trials(options) if not options.only or format_of(trial.coder) in options.only]
    points = list(measure(subject, chosen, lab))
    name = options.sequence.resolve().name
    title = f"{name}: {len(sequence)} frames"
    rows = beside(points, options.at)
    shown = {(one.coder, one.setting): one for one in chosen}
    beside_ours = [(p, shown[p.coder, p.setting]) for p in nearest_in_bytes(points, rows, options.at)]
    pictures = [
        PagePicture(f"rd-{name}", title, partial(draw, points, title), (9, 5.5)),
        PagePicture(f"rd-{name}-shown", "Original, ours, others", partial(draw_beside, subject, beside_ours), (14, 4)),
    ]
    how = (
        f"{name}, {len(sequence)} frames of at most {max(header.count for header in sequence.headers):,} Gaussians, in "
        f"{options.frames} of them from {len(cameras)} held-out cameras."
    )
    table = Table(f"rd-{name}", rows, COLUMNS)
    data = [table, Table(f"rd-{name}-points", _with_ours(points))]
    nearest = [row for row in rows if row["format"] != OURS_WHOLE][:BRIEF]
    brief = [Table("brief", nearest, dict(list(COLUMNS.items())[:3]))]
    return Page(
        [Section(verdict(name, rows, options.at), pictures=pictures, tables=brief)], how, data=data, brief=brief
    )


def trials(options: Options) -> Iterator[Trial]:
    yield from our_trials(options.targets, keep_all=False)
    yield from our_trials(options.targets, keep_all=True)
    yield from layout_trials()
    yield from written_trials()
    if options.splat4d:
        yield from splat4d_trials(options.splat4d)
    if options.fourdgs:
        yield from fourdgs_trials(options.fourdgs)
    if options.splat_transform:
        yield from splat_transform_trials(options.splat_transform)


def measure(subject: Subject, wanted: Iterable[Trial], lab: Lab) -> Iterator[RdPoint]:
    """Every trial that could be met; of the others it is told why not."""
    given = [[frames[0].means for _, frames in subject.groups], subject.measured, subject.references[0]]
    for trial in wanted:
        try:
            point = lab.results.once("rd", [trial.coder, trial.setting, given], lambda one=trial: subject.point(one))  # type: ignore[misc]
        except ConfigError as error:
            lab.tell(f"{trial.coder}, {trial.setting}: {error}")
            continue
        lab.tell(f"{point.coder}, {point.setting}: {point.kb_per_frame:.2f} kB a frame, {point.psnr:.2f} dB")
        yield point


def nearest_in_bytes(points: Sequence[RdPoint], rows: Sequence[Row], at: float) -> list[RdPoint]:
    """Our point that is nearest to `at` dB, and those of nearest bytes of the two formats that follow in rows."""
    ours = min((p for p in points if p.coder == OURS), key=lambda p: abs(p.psnr - at), default=points[0])
    others = [row["format"] for row in rows if not row["format"].startswith(OURS)][:2]
    of = [[p for p in points if format_of(p.coder) == name] for name in others]
    return [ours, *(min(some, key=lambda p: abs(p.kb_per_frame - ours.kb_per_frame)) for some in of)]


def _with_ours(points: Sequence[RdPoint]) -> list[Row]:
    """A row for each point, with the kB a frame that `airgs` takes at its PSNR."""
    ours = curves(points).get(OURS, [])
    return [row | {"ours_kb": kb_at(ours, p.psnr)} for row, p in zip(rows_of(points), points, strict=True)]


def format_of(coder: str) -> str:
    """The format that a coder's name begins with; what airgs keeps is a matter of its own."""
    return coder if coder.startswith(OURS) else coder.partition(", ")[0]


def beside(points: Sequence[RdPoint], at: float) -> list[Row]:
    """A row for each format, by its bytes at a PSNR: of its variants the best, or what it has nearest to that PSNR.

    `times`: how many times the bytes of airgs it takes at the PSNR shown; None where airgs was not measured there.
    """
    ours = curves(points).get(OURS, [])
    rows: list[Row] = []
    for name in dict.fromkeys(format_of(p.coder) for p in points):
        variants = curves([p for p in points if format_of(p.coder) == name])
        reached = {coder: kb for coder, curve in variants.items() if (kb := kb_at(curve, at)) is not None}
        if reached:
            coder = min(reached, key=lambda coder: reached[coder])
            kb, psnr = reached[coder], at
        else:
            nearest = min((p for p in points if format_of(p.coder) == name), key=lambda p: abs(p.psnr - at))
            coder, kb, psnr = f"{nearest.coder}, {nearest.setting}", nearest.kb_per_frame, nearest.psnr
        our_kb = kb_at(ours, psnr)
        times = kb / our_kb if our_kb and name != OURS else None
        variant = coder.removeprefix(name).removeprefix(", ")
        rate = bd_rate(ours, variants[coder]) if reached and name != OURS else None
        rows.append({"format": name, "kb": kb, "psnr": psnr, "times": times, "variant": variant, "bd_rate": rate})
    return sorted(rows, key=lambda row: (row["format"] != OURS, abs(row["psnr"] - at) > 0, row["kb"]))


def verdict(scene: str, rows: Sequence[Row], at: float) -> str:
    found = {row["format"]: row for row in rows if row["psnr"] == at}
    if OURS not in found:
        return f"No package of airgs was measured on both sides of {at:g} dB."
    words = f"At {at:g} dB airgs takes {found[OURS]['kb']:.1f} kB a frame of {scene}"
    others = [row for name, row in found.items() if not name.startswith(OURS)]
    if not others:
        return f"{words}. No other format that was run reaches that PSNR from both sides."
    best = min(others, key=lambda row: row["kb"])
    share = 100 * found[OURS]["kb"] / best["kb"]
    variant = f" ({best['variant']})" if best["variant"] else ""
    return f"{words}, {share:.0f} % of the nearest other, {best['format']}{variant}, which takes {best['kb']:.1f}."


def draw(points: Sequence[RdPoint], title: str, figure: Figure) -> None:
    """Bytes against PSNR: for each format the points that none of its variants beats, with its name at their end."""
    axis = figure.subplots()
    points = [p for p in points if p.coder != OURS_WHOLE]
    for name in dict.fromkeys(format_of(p.coder) for p in points):
        curve = rising([p for p in points if format_of(p.coder) == name])
        x, y = [p.kb_per_frame for p in curve], [p.psnr for p in curve]
        [line] = axis.plot(
            x, y, "o--" if name == OURS_WHOLE else "o-", linewidth=3 if name == OURS else 1.3, markersize=4
        )
        axis.annotate(name, (x[-1], y[-1]), (4, 4), textcoords="offset points", color=line.get_color(), fontsize=9)
    axis.set(xlabel="kB a frame, everything that a viewer fetches (logarithmic)", title=title)
    axis.set_ylabel("PSNR against pictures of the original, dB")
    axis.set_xscale("log")
    sizes = [p.kb_per_frame for p in points]
    axis.set_xlim(0.85 * min(sizes), 2 * max(sizes))
    plain_log_ticks(axis.xaxis, most=8)


def draw_beside(subject: Subject, chosen: Sequence[tuple[RdPoint, Trial]], figure: Figure) -> None:
    """The middle of a measured picture: as it was, and as each trial shows it."""
    number, camera = subject.measured[len(subject.measured) // 2], subject.cameras[0]
    pictures = {"original": subject.references[number][0]}
    for point, trial in chosen:
        title = f"{format_of(trial.coder)}: {point.kb_per_frame:.1f} kB a frame, {point.psnr:.1f} dB"
        pictures[title] = render(trial.code(subject).frames[number], camera).rgb
    for axis, (title, picture) in zip(figure.subplots(1, len(pictures)), pictures.items(), strict=True):
        left = max(0, picture.shape[1] - picture.shape[0]) // 2
        axis.imshow(picture[:, left : picture.shape[1] - left].clip(0, 1))
        axis.set_title(title, fontsize=10)
        axis.axis("off")
