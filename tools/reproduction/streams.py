"""Every method's stream over recorded links, frame by frame as the paper streams (its Figures of transmission time).

A key is spread evenly over the frames up to the next key, for every method alike: no link that carries the other
frames in 1 / R seconds carries a key in that time. AirGS has its levels to choose from, the others one size a frame.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from airgs_codec.decoder.decode import decode_frames
from airgs_codec.media.metrics import mse, psnr
from airgs_codec.package.store import Package
from airgs_codec.play.frame_mode import CHOOSERS, SKIPPED, FrameLog, Levels, push_frames
from airgs_codec.play.frame_table import PERCENTILES, frame_table
from airgs_codec.play.ladder import Option
from airgs_codec.play.link import Link
from airgs_codec.play.study import offsets_of
from airgs_codec.play.trace import Trace
from airgs_codec.render.backend import CPU
from airgs_codec.scene.gaussians import Gaussians
from airgs_codec.train.data.pictures import Pictures
from tools.baselines.airgs import fetched_bytes, key_bytes, state_bytes
from tools.baselines.method import Frame

SECONDS = 10.0  # that are streamed from each offset, in whole rounds of the sequence
FIGURES = ("kb_frame", "psnr", "psnr_screen", "paper_mean_ms", "paper_p95_ms", "late", "skipped", "stale", "blank")


@dataclass(frozen=True, slots=True, eq=False)
class Level:
    """A level of all T frames."""

    pruned: float  # share of the updates that is withheld
    sizes: NDArray[np.float64]  # (T,) bytes
    psnr: NDArray[np.float64]  # (T, T) dB of frame [i] while [j] should be seen, mean over held-out views


@dataclass(frozen=True, slots=True, eq=False)
class Stream:
    """What may be sent of each frame, and how it is chosen."""

    method: str
    chooser: str  # of CHOOSERS
    levels: tuple[Level, ...]  # the best one first

    @property
    def options(self) -> list[Levels]:
        """The levels of each frame."""
        numbered = list(enumerate(self.levels))
        return [
            tuple(Option(j, round(v.sizes[t]), float(v.psnr[t, t]), v.pruned) for j, v in numbered)
            for t in range(self.frames)
        ]

    @property
    def frames(self) -> int:
        """How many there are."""
        return len(self.levels[0].sizes)

    def table(self, log: FrameLog) -> dict[str, Any]:
        """The figures of a session; frames that are late or skipped count by what stands in their place."""

        def held(shown: int, due: int) -> float:
            return float(self.levels[log.levels[shown]].psnr[shown % self.frames, due % self.frames])

        return frame_table(log, held)


def one_level(frames: Sequence[Frame], shown: Sequence[Gaussians], pictures: Pictures) -> Level:
    """The frames of a method that has nothing to choose from."""
    sizes = spread_keys([f.bytes for f in frames], [f.kind == "key" for f in frames])
    return Level(0.0, sizes, psnr_of_all(shown, pictures))


def spread_keys(sizes: Sequence[float], keys: Sequence[bool]) -> NDArray[np.float64]:
    """(T,) bytes of the frames, those of each key and what follows it up to the next key being evened out.

    A frame in a group is taken to cost what it does; of a key, what exceeds the mean of the other frames of its group
    is spread over all of them.
    """
    out = np.array(sizes, float)
    starts = [t for t, key in enumerate(keys) if key or t == 0]
    for start, stop in zip(starts, [*starts[1:], len(out)], strict=True):
        rest = out[start + 1 : stop]
        if len(rest):
            extra = max(0.0, out[start] - rest.mean())
            out[start] -= extra
            out[start:stop] += extra / (stop - start)
    return out


def airgs_levels(package: Package, pictures: Pictures) -> tuple[Level, ...]:
    """The levels of a package with their shares of keys and tables, in the finest key quality."""
    m = package.manifest
    tables = (sum(fetched_bytes(package)) - m.bytes_of(m.rung_files(0, 0))) / m.frames
    levels = []
    for j, level in enumerate(m.levels):
        sizes = np.full(m.frames, tables)
        for index, segment in enumerate(m.segments):
            sizes[segment.start : segment.stop] += state_bytes(m, index, j)
        for number, group in enumerate(m.groups):
            sizes[group.start : group.stop] += key_bytes(m, number, j) / (group.stop - group.start)
        shown = [frame.gaussians for frame in decode_frames(package, 0, m.frames, level=j)]
        levels.append(Level(level.pruned, sizes, psnr_of_all(shown, pictures)))
    return tuple(levels)


def psnr_of_all(shown: Sequence[Gaussians], pictures: Pictures) -> NDArray[np.float64]:
    """(T, T) mean over held-out views of the PSNR, in dB, of each of T frames against the pictures of each of them."""
    truth = [[view.target.rgb for view in pictures.held_out(t)] for t in range(len(shown))]
    cameras = [view.camera for view in pictures.held_out(0)]
    out = np.empty((len(shown), len(shown)))
    for i, g in enumerate(shown):
        loaded = CPU.load(g)
        drawn = [loaded.draw(camera).rgb for camera in cameras]
        for t, wanted in enumerate(truth):
            out[i, t] = np.mean([psnr(mse(a, b)) for a, b in zip(drawn, wanted, strict=True)])
    return out


def stream_all(streams: Sequence[Stream], traces: Sequence[Trace], offsets: int, fps: float) -> list[dict[str, Any]]:
    """A row a stream: means over all runs, and the distribution of transmission times over all frames sent."""
    return [_stream(stream, traces, offsets, fps) for stream in streams]


def _stream(stream: Stream, traces: Sequence[Trace], offsets: int, fps: float) -> dict[str, Any]:
    loops = max(1, round(SECONDS * fps / stream.frames))
    frames, choose = stream.options * loops, CHOOSERS[stream.chooser]
    logs: list[FrameLog] = []
    for trace in traces:
        for offset in offsets_of(trace, offsets, 1):
            logs.append(push_frames(frames, fps, Link.over(trace.cut(offset).ending("loop")), choose))
    tables = [stream.table(log) for log in logs]
    times = np.concatenate([log.paper_s[log.levels != SKIPPED] for log in logs])
    finite = 1e3 * times[np.isfinite(times)]
    finite = finite if len(finite) else np.array([np.nan])  # nothing was sent
    return {
        "method": stream.method,
        "chooser": stream.chooser,
        "runs": len(logs),
        **{name: _mean([table[name] for table in tables]) for name in FIGURES},
        "worst_ms": float(finite.max()),
        "percentiles_ms": np.percentile(finite, PERCENTILES).tolist(),
    }


def _mean(values: Sequence[float]) -> float:
    """Mean of the values that are known; NaN where none is."""
    known = [value for value in values if not np.isnan(value)]
    return float(np.mean(known)) if known else np.nan
