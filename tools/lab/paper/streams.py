"""Every method's stream over recorded links, frame by frame as the paper streams (its Figures of transmission time).

A key is spread evenly over the frames up to the next key, for every method alike: no link that carries the other
frames in 1 / R seconds carries a key in that time. AirGS has its levels to choose from, the others one size a frame;
a method whose frames need no other frame may skip one that does not fit, as AirGS may.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from airgs_codec.decoder.decode import decode_frames
from airgs_codec.media.metrics import mse, psnr
from airgs_codec.package.manifest import Manifest
from airgs_codec.package.package import Package
from airgs_codec.play.ladder import Option, saved_shares
from airgs_codec.play.study import offsets_of
from airgs_codec.play.trace import Link, Trace
from airgs_codec.render.backend import CPU
from airgs_codec.scene.gaussians import Gaussians
from airgs_codec.trainer.data.pictures import Pictures
from tools.lab.baselines.airgs import fetched_bytes, key_bytes, state_bytes
from tools.lab.baselines.method import Frame
from tools.lab.paper.frames import CHOOSERS, FrameLog, Levels, frame_table, push_frames, time_percentiles
from tools.lab.paper.streaming import means

SECONDS = 10.0  # that are streamed from each offset, in whole rounds of the sequence
OURS = ("airgs", "airgs-paper")  # methods that have levels to choose from
OUR_CHOOSERS = ("unpruned", "paper", "paper-no-cliff", "paper-literal")
INDEPENDENT = ("naive3dgs",)  # methods whose frames need no other frame


@dataclass(frozen=True, slots=True, eq=False)
class Level:
    """A level of all T frames."""

    sizes: NDArray[np.float64]  # (T,) bytes
    saved: NDArray[np.float64]  # (T,) share of the bytes of the best level's states that it saves, for the cliff
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
            tuple(Option(j, round(v.sizes[t]), float(v.psnr[t, t]), float(v.saved[t])) for j, v in numbered)
            for t in range(self.frames)
        ]

    @property
    def frames(self) -> int:
        """Return how many there are."""
        return len(self.levels[0].sizes)

    def table(self, log: FrameLog) -> dict[str, Any]:
        """The figures of a session; frames that are late or skipped count by what stands in their place."""

        def held(shown: int, due: int) -> float:
            return float(self.levels[log.levels[shown]].psnr[shown % self.frames, due % self.frames])

        return frame_table(log, held)


def one_level(frames: Sequence[Frame], shown: Sequence[Gaussians], pictures: Pictures) -> Level:
    """The frames of a method that has nothing to choose from."""
    sizes = spread_keys([f.bytes for f in frames], [f.kind == "key" for f in frames])
    return Level(sizes, np.zeros(len(sizes)), psnr_of_all(shown, pictures))


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
    saved = saved_by_level(m)
    levels = []
    for j in range(len(m.levels)):
        sizes = np.full(m.frames, tables)
        for index, segment in enumerate(m.segments):
            sizes[segment.start : segment.stop] += state_bytes(m, index, j)
        for number, group in enumerate(m.groups):
            sizes[group.start : group.stop] += key_bytes(m, number, j) / (group.stop - group.start)
        shown = [frame.gaussians for frame in decode_frames(package, 0, m.frames, level=j)]
        levels.append(Level(sizes, saved[j], psnr_of_all(shown, pictures)))
    return tuple(levels)


def saved_by_level(m: Manifest) -> NDArray[np.float64]:
    """(L, T) share of the bytes of level 0 that each level saves in each frame's segment, as players count them."""
    saved = np.empty((len(m.levels), m.frames))
    for segment in m.segments:
        saved[:, segment.start : segment.stop] = np.array(saved_shares([v.file.bytes for v in segment.levels]))[:, None]
    return saved


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


def streams_of(method: str, levels: tuple[Level, ...]) -> list[Stream]:
    """The streams of a method: each way to choose among its levels, or to skip, that its frames allow."""
    choosers = OUR_CHOOSERS if method in OURS else ("unpruned", "paper-no-cliff")[: 1 + (method in INDEPENDENT)]
    return [Stream(method, chooser, levels) for chooser in choosers]


def stream(one: Stream, traces: Sequence[Trace], offsets: int, fps: float) -> dict[str, Any]:
    """A row: means over all runs, and the distribution of transmission times over all frames."""
    frames = one.options * max(1, round(SECONDS * fps / one.frames))
    links = [Link.over(trace.cut(at).ending("loop")) for trace in traces for at in offsets_of(trace, offsets, 1)]
    logs = [push_frames(frames, fps, link, CHOOSERS[one.chooser]) for link in links]
    row = means(one.chooser, [one.table(log) for log in logs])
    return {"method": one.method} | row | {"percentiles_ms": time_percentiles(logs)}
