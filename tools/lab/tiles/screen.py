"""What a viewer saw of a session, drawn again and compared with the original."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from airgs_codec.decoder.decode import Part, decode_frames
from airgs_codec.package.package import Package
from airgs_codec.play.session import SessionLog
from airgs_codec.play.sight import View, half_angles
from airgs_codec.render.cpu import render
from airgs_codec.scene.camera import Camera
from airgs_codec.scene.gaussians import Gaussians, join_rows
from airgs_codec.scene.sequence import GaussianSequence

SIGMAS = 3.0  # of a Gaussian, within which it is seen
Squares = NDArray[np.float32]


@dataclass(slots=True)
class Seen:
    """Squared errors of pictures, pooled."""

    squares: float = 0.0
    samples: int = 0
    worst: float = 0.0  # mean squared error of a picture

    def add(self, squares: Squares) -> None:
        """The squared errors of a picture, or of a part of it."""
        if squares.size:
            self.squares += float(squares.sum(dtype=np.float64))
            self.samples += squares.size
            self.worst = max(self.worst, float(squares.mean(dtype=np.float64)))

    @property
    def psnr(self) -> float:
        """dB; NaN where nothing was seen."""
        return -10 * math.log10(max(self.squares / self.samples, 1e-12)) if self.samples else math.nan

    @property
    def worst_psnr(self) -> float:
        """dB, of the worst picture."""
        return -10 * math.log10(max(self.worst, 1e-12))


@dataclass(eq=False)
class Decoded:
    """A package, decoded tile by tile when it is asked for."""

    package: Package
    frames: frozenset[int]
    _kept: dict[tuple[int, int, int], dict[int, Gaussians]] = field(default_factory=dict)

    def tile(self, rung: tuple[int, int], tile: int, number: int) -> Gaussians:
        """A frame of a tile in a rung: key quality, level."""
        place = (*rung, tile)
        if place not in self._kept:
            quality, level = rung
            m = self.package.manifest
            shown = decode_frames(self.package, 0, m.frames, level=level, key_quality=quality, part=Part(tiles=[tile]))
            self._kept[place] = {f.number: f.gaussians for f in shown if f.number in self.frames}
        return self._kept[place][number]


@dataclass(frozen=True, slots=True)
class Moment:
    """A picture: frame, seconds after the first picture, and the rung of every tile that is there."""

    frame: int
    at_s: float
    tiles: tuple[tuple[int, int], ...]  # (tile, rung)


@dataclass(eq=False)
class Screen:
    """Pictures of a package for one viewer; `ticks` of each segment are drawn."""

    sequence: GaussianSequence
    package: Package
    view: View
    ticks: int
    originals: dict[tuple[int, float], tuple[Camera, Squares]]  # (frame, time) -> view, (H, W, 3); shared
    _errors: dict[Moment, Squares] = field(default_factory=dict)

    @cached_property
    def _decoded(self) -> Decoded:
        spans = [(s.start, s.stop) for s in self.package.manifest.segments]
        return Decoded(self.package, frozenset(n for span in spans for n in self._numbers(*span)))

    def _numbers(self, start: int, stop: int) -> list[int]:
        return [start + (2 * k + 1) * (stop - start) // (2 * self.ticks) for k in range(self.ticks)]

    def moments(self, log: SessionLog) -> list[Moment]:
        """The pictures of a session: `ticks` of each segment shown, as it was shown."""
        fps, m, first_s = log.offers.fps, self.package.manifest, log.shown[0].start_s
        found = []
        for position, entry in enumerate(log.shown):
            span = m.segments[entry.segment]
            for number in self._numbers(span.start, span.stop):
                at_s = entry.start_s + (number - span.start) / fps
                everything = dict.fromkeys(range(m.tiles), entry.rung or 0)
                there = everything if log.tiles is None else log.tiles.there(position, at_s)
                found.append(Moment(number, round(at_s - first_s, 3), tuple(sorted(there.items()))))
        return found

    def squares(self, log: SessionLog, moment: Moment) -> Squares:
        """(H, W, 3) squared errors of a picture. Tiles that are out of sight are not drawn."""
        camera, truth = self._original(moment)
        near = tuple((t, r) for t, r in moment.tiles if touches(self.part(log, t, r, moment.frame), camera))
        place = Moment(moment.frame, moment.at_s, near)
        if place not in self._errors:
            parts = [self.part(log, tile, rung, moment.frame) for tile, rung in near]
            shown = render(join_rows(parts), camera).rgb if parts else np.asarray(camera.background, truth.dtype)
            self._errors[place] = np.square(np.clip(shown, 0, 1) - truth, dtype=np.float32)
        return self._errors[place]

    def part(self, log: SessionLog, tile: int, rung: int, frame: int) -> Gaussians:
        """A frame of a tile in a rung of the session."""
        return self._decoded.tile(log.offers.rungs[rung], tile, frame)

    def _original(self, moment: Moment) -> tuple[Camera, Squares]:
        place = moment.frame, moment.at_s
        if place not in self.originals:
            camera = self.view.at(moment.at_s)
            truth = np.clip(render(self.sequence.read(moment.frame), camera).rgb, 0, 1)
            self.originals[place] = camera, truth.astype(np.float32)
        return self.originals[place]

    def look(self, log: SessionLog) -> Seen:
        """The errors of a session's pictures."""
        seen = Seen()
        for moment in self.moments(log):
            seen.add(self.squares(log, moment))
        return seen


def touches(frame: Gaussians, camera: Camera) -> bool:
    """Return whether any Gaussian of a frame is in the picture, to SIGMAS."""
    means = frame.means.astype(np.float64) @ camera.world_to_camera[:3, :3].T + camera.world_to_camera[:3, 3]
    z = means[:, 2]
    across, down = np.tan(half_angles(camera))
    reach = SIGMAS * np.exp(frame.log_scales.max(axis=1).astype(np.float64)) * np.hypot(1, max(across, down))
    inside = (np.abs(means[:, 0]) <= z * across + reach) & (np.abs(means[:, 1]) <= z * down + reach)
    return bool(((z > camera.near) & inside).any())
