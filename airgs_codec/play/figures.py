"""What the figures of sessions are called in tables, and what they mean.

PSNR has three definitions in this package. Packages: the PSNR of the squared error pooled over views and frames.
Training: the mean over views of each view's dB. Sessions, here: every segment has the package's PSNR of its rung, and
a session the mean of these dB over display ticks.
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


def headlines(figures: tuple[Figure, ...]) -> list[Figure]:
    """The figures that pages and terminals show."""
    return [figure for figure in figures if figure.headline]


def meanings(figures: tuple[Figure, ...]) -> dict[str, str]:
    """Name of every figure -> what it means."""
    return {figure.name: figure.meaning for figure in figures}
