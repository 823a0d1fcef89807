"""The paper's server for one viewer, as a reference for the stateless package.

The server keeps D'_t, what this viewer has, and sends d'_t = p(D_t - D'_{t-1}) in whole steps: p keeps the rows with
the highest usage, and the pruned share is chosen for every frame so that the frame fits B / R (arXiv 2512.20943,
Algorithm 1, but without its cliff: all shares are searched). D_t is the top rung of a package rounded to its steps. The
viewer decodes each message and adds it: GS_t = GC_k + sum of d'_t. Which rows a message carries follows from its pruned
share and from usage, which both sides know.

T frames of a group, n rows that move, C colour channels beside the ten of position, rotation, scale and opacity.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from airgs_codec._settings import setting
from airgs_codec.coding.rangecoder import ColumnReader, encode_columns
from airgs_codec.media.metrics import mse, psnr
from airgs_codec.package.package import Package, open_package
from airgs_codec.play.offers import Offers
from airgs_codec.play.policies.paper import frame_budget
from airgs_codec.play.trace import Link, Trace
from airgs_codec.progress import Progress, silent
from airgs_codec.render import Camera, read_cameras
from airgs_codec.render.backend import CPU, Renderer
from tools.lab.options import required
from tools.lab.page import Page, Section, Table
from tools.lab.paper.states import SHARES, GroupStates, checking_views, kept_rows, load_states, score_rows

if TYPE_CHECKING:
    from tools.lab.command import Lab

WrittenRows = Mapping[float, NDArray[np.bool_]]  # pruned share -> (n,) rows whose changes are sent
Chooser = Callable[["Server", int, float], float]  # server, frame of the group, budget in bytes -> pruned share


@dataclass(frozen=True, slots=True)
class ServedFrame:
    """What one frame cost, and what its viewer saw."""

    frame: int  # number in the package
    pruned: float  # share of the rows that was withheld, 0..1
    bytes: int  # of the message
    budget: float  # bytes that the frame was allowed, B / R
    stale: float  # share of the moving rows whose D' is not D, 0..1
    drift: int  # largest difference between what the viewer decoded and the server's D'_t, in steps
    mse: float  # viewer's pictures against the top rung's, mean over the views; NaN after the first loop


@dataclass(frozen=True, slots=True)
class ClosedLoopSettings:
    """Who is served, and over what."""

    training: Sequence[Camera]  # views in which the usage of rows is measured
    views: Sequence[Camera]  # views in which the error is rendered
    link: Link | None = None  # None: budgets are unlimited
    loops: int = 1  # times that the sequence is played
    ranking: str = "hits"  # measure of usage that rows are ranked by (the paper's: hits), one of MEASURED
    renderer: Renderer = CPU


def encode_change(change: NDArray[np.int32], kept: WrittenRows, share: float) -> bytes:
    """The message of (10 + C, n) whole steps, of which only the rows in `kept[share]` are sent.

    One byte for the share, one bit for each channel that changes, then those channels in the adaptive range coder. A
    share of 1 is the empty message.
    """
    if share == 1:
        return b""
    rows = change[:, kept[share]].astype(np.int64)
    used = rows.any(axis=1)
    zigzag = (rows[used] << 1) ^ (rows[used] >> 63)
    head = bytes([SHARES.index(share)]) + np.packbits(used).tobytes()
    return head + encode_columns([(column, 1) for column in zigzag])


def decode_change(message: bytes, kept: WrittenRows, channels: int) -> NDArray[np.int32]:
    """(10 + C, n) whole steps of a message, zeros in the rows that it withholds; `channels` is 10 + C.

    Raises FormatError for a message that is cut short or too long.
    """
    share = SHARES[message[0]] if message else 1.0
    rows = kept[share]
    change = np.zeros((channels, len(rows)), np.int32)
    if message:
        end = 1 + -(-channels // 8)
        used = np.unpackbits(np.frombuffer(message[1:end], np.uint8), count=channels).astype(bool)
        reader = ColumnReader(message[end:], "message")
        for channel in np.flatnonzero(used):
            zigzag = reader.column(int(rows.sum()), 1)
            change[channel, rows] = (zigzag >> 1) ^ -(zigzag & 1)
        reader.close()
    return change


class Server:
    """The server's side of one viewer in one group; `send` advances it by a frame."""

    def __init__(self, states: GroupStates, kept: WrittenRows) -> None:
        scaled = states.values / states.steps[:, None].astype(np.float32)
        self.wanted = np.rint(scaled).astype(np.int32)  # (T, 10 + C, n) D_t in steps
        self.sent = np.zeros_like(self.wanted[0])  # (10 + C, n) D'_t
        self._kept = kept

    def message(self, frame: int, share: float) -> bytes:
        """The message that brings the viewer to a frame of the group, with a pruned share of SHARES."""
        return encode_change(self.wanted[frame] - self.sent, self._kept, share)

    def fit(self, frame: int, budget: float) -> float:
        """The least pruned share whose message fits, by bisection as in Algorithm 1 (sizes fall with the share)."""
        low, high = 0, len(SHARES) - 1
        while low < high:
            middle = (low + high) // 2
            if len(self.message(frame, SHARES[middle])) <= budget:
                high = middle
            else:
                low = middle + 1
        return SHARES[low]

    def send(self, frame: int, share: float) -> bytes:
        """The message of a frame, taken for received: D'_t is now what it says."""
        message = self.message(frame, share)
        self.sent = np.where(self._kept[share], self.wanted[frame], self.sent)
        return message

    def stale(self, frame: int) -> float:
        """Share of the moving rows, 0..1, whose D'_t is not D_t."""
        return float((self.sent != self.wanted[frame]).any(axis=0).mean()) if self.sent.size else 0.0


class Viewer:
    """The viewer's side in one group: what it has decoded so far, in steps."""

    def __init__(self, states: GroupStates, kept: WrittenRows) -> None:
        self.held = np.zeros(states.values.shape[1:], np.int32)  # (10 + C, n)
        self._kept = kept

    def receive(self, message: bytes) -> None:
        """Decode a message and add it. Raises FormatError."""
        self.held = self.held + decode_change(message, self._kept, len(self.held))


def adaptive(server: Server, frame: int, budget: float) -> float:
    """The paper's choice: the least pruned share that fits the budget in bytes."""
    return server.fit(frame, budget)


def always(share: float) -> Chooser:
    """One pruned share of SHARES for every frame."""
    return lambda server, frame, budget: share


def run_closed_loop(
    package: Package, choose: Chooser, settings: ClosedLoopSettings, progress: Progress = silent
) -> list[ServedFrame]:
    """Serve the package's sequence `settings.loops` times; `choose` gives the pruned share of every frame.

    Budgets are B / R at the frame's moment of the link's trace. The frames of the first loop are rendered. Raises
    FormatError.
    """
    m = package.manifest
    groups = [_open_group(package, group, settings) for group in range(len(m.groups))]
    served: list[ServedFrame] = []
    for loop in range(settings.loops):
        for group in groups:
            for frame in _serve(group, choose, settings, loop * m.frames):
                progress("frames", len(served), settings.loops * m.frames)
                served.append(frame)
    return served


@dataclass(frozen=True, slots=True, eq=False)
class _Group:
    """What both sides know of a group before its first frame."""

    states: GroupStates
    kept: WrittenRows
    fps: float


def _open_group(package: Package, group: int, settings: ClosedLoopSettings) -> _Group:
    states = load_states(package, group)
    score = score_rows(states, list(settings.training), settings.renderer)[settings.ranking]
    return _Group(states, {share: kept_rows(score, share) for share in SHARES}, float(package.manifest.fps))


def _serve(group: _Group, choose: Chooser, settings: ClosedLoopSettings, played: int) -> Iterator[ServedFrame]:
    """The frames of a group one by one, after `played` frames of whole loops; only the first loop is rendered."""
    states, link = group.states, settings.link
    server, viewer = Server(states, group.kept), Viewer(states, group.kept)
    for t in range(len(states.values)):
        at_s = (played + states.start + t) / group.fps
        budget = frame_budget(link.trace.rate_at(at_s), group.fps) if link else np.inf
        share = choose(server, t, budget)
        message = server.send(t, share)
        viewer.receive(message)
        yield ServedFrame(
            frame=states.start + t,
            pruned=share,
            bytes=len(message),
            budget=budget,
            stale=server.stale(t),
            drift=int(np.abs(viewer.held - server.sent).max(initial=0)),
            mse=np.nan if played else _error(states, viewer, t, settings),
        )


def _error(states: GroupStates, viewer: Viewer, t: int, settings: ClosedLoopSettings) -> float:
    """Mean squared error, over pixels and views, of what the viewer shows of a frame against the top rung."""
    steps = states.steps[:, None].astype(np.float32)
    shown = settings.renderer.load(states.show(viewer.held.astype(np.float32) * steps))
    top = settings.renderer.load(states.show(states.values[t]))
    return float(np.mean([mse(shown.draw(camera).rgb, top.draw(camera).rgb) for camera in settings.views]))


def closed_loop_table(served: Sequence[ServedFrame]) -> dict[str, float]:
    """Means over frames, and maxima where the name says so.

    `psnr_to_top` is the PSNR of the squared error pooled over frames and views, NaN where none was rendered.
    """
    measured = np.array([frame.mse for frame in served if np.isfinite(frame.mse)])
    return {
        "frames": len(served),
        "kb_frame": float(np.mean([frame.bytes for frame in served]) / 1e3),
        "worst_kb": max(frame.bytes for frame in served) / 1e3,
        "pruned": float(np.mean([frame.pruned for frame in served])),
        "skipped": float(np.mean([frame.pruned == 1 for frame in served])),
        "stale": float(np.mean([frame.stale for frame in served])),
        "drift_steps": max(frame.drift for frame in served),
        "psnr_to_top": psnr(float(measured.mean())) if len(measured) else float("nan"),
    }


@dataclass(frozen=True, slots=True)
class Options:
    """Whom the paper's server serves, over what."""

    package: Path = required("folder of a package")
    trace: str = required("trace, as airgs-play takes it")
    loops: int | None = setting(None, "times that the sequence is played; as airgs-play where not told")
    views: Path | None = setting(None, "cameras that see the pictures, in place of views drawn")


COLUMNS = {
    "kb_frame": ("state kB a frame", ".2f"),
    "worst_kb": ("worst frame, kB", ".2f"),
    "pruned": ("pruned", ".0%"),
    "skipped": ("frames skipped", ".1%"),
    "psnr_to_top": ("dB to the top rung", ".2f"),
    "stale": ("stale rows", ".1%"),
    "drift_steps": ("drift, steps", ".0f"),
}


def run(options: Options, lab: Lab) -> Page:
    """Serve one viewer. Raises ConfigError, FormatError, TransportError."""
    package, link = open_package(options.package), Link.over(Trace.open(options.trace))
    m = package.manifest
    training, measured = checking_views(m.region, list(read_cameras(options.views)) if options.views else [])
    settings = ClosedLoopSettings(training, measured, link, Offers(m).loops(options.loops))
    row = closed_loop_table(run_closed_loop(package, adaptive, settings, lab.progress))
    state = sum(m.bytes_of(m.state_files(i, 0)) for i in range(len(m.segments))) / m.frames / 1e3
    answer = f"Level 0 of the package, which is the same for every viewer, has {state:.2f} kB a frame."
    table = Table("closed-loop", [row], COLUMNS)
    return Page([Section(answer, tables=[table])], "PSNR is that of the pooled error of the first loop.")
