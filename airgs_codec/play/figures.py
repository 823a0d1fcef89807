"""What the figures of sessions and of frame mode are called in tables, and what they mean.

PSNR has three definitions in this package. Packages: the PSNR of the squared error pooled over views and frames.
Training: the mean over views of each view's dB. Sessions, here: every segment has the package's PSNR of its rung, and
a session the mean of these dB over display ticks (or over frames sent, in frame mode).
"""

from __future__ import annotations

from dataclasses import dataclass

from airgs_codec.package.paths import FileKind

TICK_PSNR = "mean over display ticks of the dB of what was on the screen; frozen pictures count"
KINDS = (FileKind.KEY, FileKind.STATE, FileKind.SIDECARS, FileKind.INIT, FileKind.MANIFESTS)  # of bytes


@dataclass(frozen=True, slots=True)
class Figure:
    """One column of a table."""

    name: str  # in rows and records
    heading: str  # with the unit
    meaning: str
    factor: float = 1.0  # from the row's unit to the heading's
    digits: int = 2
    headline: bool = False  # one of those that pages and terminals show; CSV has all

    def text(self, value: float) -> str:
        """A value of a row in the heading's unit."""
        return f"{self.factor * value:.{self.digits}f}"


FIGURES = (
    Figure("psnr_mean", "PSNR dB", TICK_PSNR, headline=True),
    Figure("psnr_p5", "5th %ile dB", "5th percentile over display ticks of the same dB", headline=True),
    Figure("stall_ratio", "stalled %", "waiting after the first picture, of the time since", 100, headline=True),
    Figure("startup_s", "start-up s", "from the first request to the first picture", headline=True),
    Figure("switches", "switches", "changes of the rung from one segment to the next", 1, 1, headline=True),
    Figure("bytes_per_frame", "kB/frame", "files that were of use, without headers", 1e-3, headline=True),
    Figure("regret", "regret dB", "PSNR under the bound for the same moments, mean over media time", headline=True),
    Figure("change_db", "change dB", "mean change of PSNR from one segment to the next"),
    Figure("qoe", "QoE dB", "a segment: quality - changes - 20 dB for a second of waiting"),
    Figure("wasted", "wasted %", "bytes that served nothing, of those on the wire", 100, 1),
    Figure("utilisation", "used %", "bytes on the wire, of those that could have passed", 100, 0),
    Figure("infeasible", "no fit %", "choices for which no rung fitted", 100, 1),
    Figure("late", "late %", "segments that were waited for", 100, 1),
    Figure("frame_ms_mean", "mean ms", "time a frame was on its way: its share of the batch that brought it", 1, 0),
    Figure("frame_ms_p50", "median ms", "median over frames of the same time", 1, 0),
    Figure("frame_ms_p95", "95 % ms", "95th percentile over frames of the same time", 1, 0),
    Figure("frame_ms_max", "worst ms", "the longest of these times", 1, 0),
    *(Figure(f"{kind}_kb_frame", f"{kind} kB", f"kB a frame of {kind} files, without headers") for kind in KINDS),
)

FRAME_FIGURES = (
    Figure("kb_frame", "kB/frame", "state sent", headline=True),
    Figure("psnr", "PSNR dB", "mean over the frames sent of the dB of their level", headline=True),
    Figure(
        "psnr_screen", "screen dB", "mean over frames of the dB of the frame that stood at its moment", headline=True
    ),
    Figure("paper_mean_ms", "mean ms", "bits over the rate of that moment, outages left out", 1, 1, headline=True),
    Figure("paper_p95_ms", "95 % ms", "95th percentile of the same time", 1, 1, headline=True),
    Figure("paper_max_ms", "worst ms", "the longest of these times", 1, 1, headline=True),
    Figure("late", "late %", "frames that were not through the link when the next was due", 100, 1),
    Figure("skipped", "skipped %", "frames of which nothing was sent", 100, 1, headline=True),
    Figure("stale", "stale %", "frames at whose moment an earlier one stood: skipped, or late", 100, 1),
    Figure("blank", "blank %", "frames at whose moment none had come yet; not in the dB on the screen", 100, 1),
    Figure("paper_max_ms_share", "of unpruned", "the longest time over the unpruned stream's, median over runs"),
    Figure("infeasible", "no fit %", "frames for which no level fitted", 100, 1),
    Figure("outage", "outage %", "frames pushed while the rate was zero", 100, 1),
    Figure("link_mean_ms", "link mean ms", "time over the link, one frame after another", 1, 1),
    Figure("link_p50_ms", "link median ms", "median of the same time", 1, 1),
    Figure("link_p95_ms", "link 95 % ms", "95th percentile of the same time", 1, 1),
    Figure("link_max_ms", "link worst ms", "the longest of these times", 1, 0),
    Figure("link_max_ms_share", "link of unpruned", "that over the unpruned stream's, median over runs"),
)


def headlines(figures: tuple[Figure, ...]) -> list[Figure]:
    """The figures that pages and terminals show."""
    return [figure for figure in figures if figure.headline]


def meanings(figures: tuple[Figure, ...]) -> dict[str, str]:
    """Name of every figure -> what it means."""
    return {figure.name: figure.meaning for figure in figures}
