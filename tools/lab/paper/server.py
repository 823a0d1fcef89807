"""The paper's server for one viewer (arXiv 2512.20943, its equations 11 and 12), who lacks from 0 to 100 % in tens.

Of each frame it sends d' = p(D - D') in whole steps: D is what differs from the keyframe GC of the group, D' what its
viewer has of that, and p keeps the rows that most pixels show, as many as a level of SHARES says. The viewer shows
GC + D'. D is what a package has without pruning, GC what it shows where all is pruned; keyframes are those of the
package.

N rows of a group, C channels of all their attributes, T frames in all.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from airgs_codec.coding.rangecoder import encode_columns
from airgs_codec.decoder.decode import decode_frames
from airgs_codec.package.package import Package
from airgs_codec.play.ladder import Option
from airgs_codec.render.backend import CPU
from airgs_codec.scene.gaussians import Gaussians
from airgs_codec.trainer.data.pictures import ScenePictures
from airgs_codec.trainer.fit.losses import GAUSSIAN_FIELDS, codec_steps
from tools.lab.paper.streams import SKIPPED, Levels, Source, keyframe_shares, psnr_of

SHARES = tuple(j / 10 for j in range(11))  # of the rows whose changes are withheld
KEPT_STATES = 64


@dataclass(frozen=True, slots=True, eq=False)
class Group:
    start: int  # its first frame
    key: NDArray[np.float32]  # (N, C) GC
    steps: NDArray[np.float32]  # (N, C)
    wanted: NDArray[np.int64]  # (frames, N, C) D in steps
    places: NDArray[np.intp]  # (N,) of rows by usage, 0 the row that most pixels show


class Server(Source):
    def __init__(self, package: Package, pictures: ScenePictures) -> None:
        m = package.manifest
        self.count, self._pictures, self._shared = m.frames, pictures, keyframe_shares(package, 0)
        top, key = (
            [frame.gaussians for frame in decode_frames(package, 0, m.frames, level=level)]
            for level in (0, len(m.levels) - 1)
        )
        self._like = top[0]
        self._groups = [_open(top[g.start : g.stop], key[g.start], g.start, pictures) for g in m.groups]
        self._of_frame = [number for number, g in enumerate(m.groups) for _ in range(g.start, g.stop)]
        self.levels_after = lru_cache(None)(self._levels_after)
        self.shown = lru_cache(None)(self._shown)
        self.held = lru_cache(KEPT_STATES)(self._held)

    def levels(self, past: Sequence[int]) -> Levels:
        return self.levels_after(*self._sent(past, len(past)))

    def psnr(self, sent: Sequence[int], old: int, due: int) -> float:
        return float(self.shown(*self._sent(sent, old, 1))[due % self.count])

    def _sent(self, levels: Sequence[int], frame: int, more: int = 0) -> tuple[int, tuple[int, ...]]:
        """The group of a frame, and the levels of its frames before it, and of it with one `more`."""
        number = self._of_frame[frame % self.count]
        start = frame - frame % self.count + self._groups[number].start
        return number, tuple(len(SHARES) - 1 if j == SKIPPED else int(j) for j in levels[start : frame + more])

    def _levels_after(self, number: int, sent: tuple[int, ...]) -> Levels:
        group, t = self._groups[number], len(sent)
        change, levels = group.wanted[t] - self.held(number, sent), []
        for j, share in enumerate(SHARES):
            size = round(self._shared[group.start + t]) + len(message(change[_kept(group, j)]))
            levels.append(Option(j, size, float(self.shown(number, (*sent, j))[group.start + t]), share))
        return tuple(levels)

    def _held(self, number: int, sent: tuple[int, ...]) -> NDArray[np.int64]:
        """(N, C) D' of a viewer to whom the first frames of a group were sent at these levels."""
        group = self._groups[number]
        if not sent:
            return np.zeros_like(group.wanted[0])
        return np.where(_kept(group, sent[-1])[:, None], group.wanted[len(sent) - 1], self.held(number, sent[:-1]))

    def _shown(self, number: int, sent: tuple[int, ...]) -> NDArray[np.float64]:
        group, like = self._groups[number], self._like
        columns = (group.key + group.steps * self.held(number, sent)).astype(np.float32)
        ends = np.cumsum([getattr(like, name)[0].size for name in GAUSSIAN_FIELDS])[:-1]
        parts = zip(GAUSSIAN_FIELDS, np.split(columns, ends, axis=1), strict=True)
        shown = Gaussians(*(part.reshape(len(part), *getattr(like, name).shape[1:]) for name, part in parts))
        return psnr_of(shown, self._pictures, self.count)


def message(change: NDArray[np.int64]) -> bytes:
    """Whole steps (n, C) of the rows that are sent: a byte of their share, a bit of each channel, those that change."""
    used = change.any(axis=0)
    zigzag = (change[:, used] << 1) ^ (change[:, used] >> 63)
    return bytes(1) + np.packbits(used).tobytes() + encode_columns([(column, 1) for column in zigzag.T])


def _open(frames: Sequence[Gaussians], key: Gaussians, start: int, pictures: ScenePictures) -> Group:
    cameras = [view.camera for view in pictures.train(start)]
    steps = np.concatenate([step.numpy().reshape(len(key), -1) for step in codec_steps(key, cameras).values()], axis=1)
    base, loaded = _columns(key), CPU.load(key)
    hits = np.sum([loaded.contribution(camera).hits for camera in cameras], axis=0)
    wanted = np.stack([np.rint((_columns(g) - base) / steps) for g in frames]).astype(np.int64)
    return Group(start, base, steps, wanted, np.argsort(np.argsort(-hits, kind="stable")))


def _columns(g: Gaussians) -> NDArray[np.float32]:
    return np.concatenate([getattr(g, name).reshape(len(g), -1) for name in GAUSSIAN_FIELDS], axis=1)


def _kept(group: Group, level: int) -> NDArray[np.bool_]:
    return group.places < round((1 - SHARES[level]) * len(group.places))
