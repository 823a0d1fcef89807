"""What a viewer sees of a scene in tiles, and what it costs, by rule."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from airgs_codec.decoder.decode import decode_frames
from airgs_codec.package.store import Package
from airgs_codec.progress import Progress
from airgs_codec.render.cpu import render
from airgs_codec.scene.camera import Camera
from airgs_codec.scene.gaussians import Gaussians
from airgs_codec.scene.sequence import GaussianSequence
from tools.tiles.rules import Choice, Rule
from tools.tiles.split import Tile, border_pixels, border_rows, joined
from tools.tiles.stock import Stock
from tools.tiles.viewer import Watcher, touches

WHOLE, TILED = "whole", "all tiles"
Key = tuple[str, int]  # of a rule: its name, and its place on the ladder


@dataclass(slots=True)
class Seen:
    """Squared errors of pictures, pooled."""

    squares: float = 0.0
    samples: int = 0
    worst: float = 0.0  # mean squared error of a picture

    def add(self, squares: NDArray[np.floating]) -> None:
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
    """Some frames of a package in the rungs of its ladder, decoded when they are asked for."""

    package: Package
    frames: tuple[int, ...]
    _kept: dict[int, dict[int, Gaussians]] = field(default_factory=dict)

    def frame(self, place: int, number: int) -> Gaussians:
        """A frame in a rung of the ladder."""
        if place not in self._kept:
            m = self.package.manifest
            shown = decode_frames(self.package, 0, m.frames, level=place, key_quality=m.levels[place].quality)
            self._kept[place] = {f.number: f.gaussians for f in shown if f.number in self.frames}
        return self._kept[place][number]


@dataclass(eq=False)
class Bench:
    """A scene, its package and the packages of its tiles, and a viewer's walk."""

    sequence: GaussianSequence
    whole: Package
    parts: Sequence[Package]
    tiles: Sequence[Tile]
    watcher: Watcher
    segments: int  # that are shown; the sequence is played over and over
    ticks: int  # pictures that are drawn of each segment

    def __post_init__(self) -> None:
        spans = [(s.start, s.stop) for s in self.whole.manifest.segments]
        self.spans = [spans[n % len(spans)] for n in range(self.segments)]
        lengths = [(stop - start) / float(self.whole.manifest.fps) for start, stop in self.spans]
        self.starts = np.concatenate([[0.0], np.cumsum(lengths)])
        needed = {number for span in set(self.spans) for number in self._numbers(span)}
        self.originals = {number: self.sequence.read(number) for number in sorted(needed)}
        self.borders = {number: border_rows(frame, self.tiles) for number, frame in self.originals.items()}
        self.decoded = [Decoded(package, tuple(sorted(needed))) for package in (self.whole, *self.parts)]
        self.factors = [level.factor for level in self.whole.manifest.levels]

    def _numbers(self, span: tuple[int, int]) -> list[int]:
        start, stop = span
        return [start + (2 * k + 1) * (stop - start) // (2 * self.ticks) for k in range(self.ticks)]

    def cost(self, choices: Sequence[Choice], packages: Sequence[Package]) -> int:
        """Bytes on the wire of what is chosen of every package, segment by segment."""
        stocks, count = [Stock.of(package) for package in packages], len(self.whole.manifest.segments)
        for number, choice in enumerate(choices):
            for stock, place in zip(stocks, choice, strict=True):
                if place is not None:
                    stock.fetch(number // count, number % count, stock.ladder()[place])
        return sum(stock.bytes for stock in stocks)

    def run(self, rules: Sequence[Rule], progress: Progress) -> list[dict[str, Any]]:
        """A row for every rung of the whole package and of all tiles, and for every rule."""
        plans, ladder = self._plans(rules), range(len(self.factors))
        seen = {key: Seen() for key in [*((WHOLE, base) for base in ladder), *plans]}
        bands = {(name, base): (Seen(), Seen()) for name in (WHOLE, TILED) for base in ladder}
        for n in range(self.segments):
            progress("segments seen", n, self.segments)
            for tick, number in enumerate(self._numbers(self.spans[n])):
                part = (tick + 0.5) / self.ticks
                camera = self.watcher.at(float(self.starts[n] + part * (self.starts[n + 1] - self.starts[n])))
                self._look(camera, number, {key: plan[n] for key, plan in plans.items()}, (seen, bands))
        rows = []
        for (name, base), pictures in seen.items():
            if name == WHOLE:
                size = self.cost([(base,)] * self.segments, [self.whole])
            else:
                size = self.cost(plans[name, base], self.parts)
            row = {"rule": name, "rung": base, "bytes": size, "mbps": 8e-6 * size / float(self.starts[-1])}
            row |= {"psnr": pictures.psnr, "worst_psnr": pictures.worst_psnr}
            if (name, base) in bands:
                at, off = bands[name, base]
                row |= {"border_psnr": at.psnr, "elsewhere_psnr": off.psnr, "border_samples": at.samples}
            rows.append(row)
        return rows

    def _plans(self, rules: Sequence[Rule]) -> dict[Key, list[Choice]]:
        """What is chosen for every segment, with all tiles in each rung and by every rule."""
        everything: list[Choice] = [(base,) * len(self.tiles) for base in range(len(self.factors))]
        plans = {(TILED, base): [choice] * self.segments for base, choice in enumerate(everything)}
        spans = list(itertools.pairwise(self.starts.tolist()))
        for rule in rules:
            plans[rule.name, rule.base] = [rule.choose(self.tiles, self.watcher, span, self.factors) for span in spans]
        return plans

    def _look(
        self,
        camera: Camera,
        number: int,
        choices: dict[Key, Choice],
        counts: tuple[dict[Key, Seen], dict[Key, tuple[Seen, Seen]]],
    ) -> None:
        """One picture by every rule."""
        seen, bands = counts
        original = self.originals[number]
        truth = np.clip(render(original, camera).rgb, 0, 1)
        masks = border_pixels(original, self.borders[number], camera)
        near = [touches(original.take(tile.rows), camera) for tile in self.tiles]
        drawn: dict[Choice, NDArray[np.floating]] = {}
        for key in seen:
            if key[0] == WHOLE:
                squares = self._squares([self.decoded[0].frame(key[1], number)], camera, truth)
            else:
                shown = tuple(place if close else None for place, close in zip(choices[key], near, strict=True))
                if shown not in drawn:
                    parts = [d.frame(p, number) for d, p in zip(self.decoded[1:], shown, strict=True) if p is not None]
                    drawn[shown] = self._squares(parts, camera, truth)
                squares = drawn[shown]
            seen[key].add(squares)
            for band, mask in zip(bands.get(key, ()), masks, strict=False):
                band.add(squares[mask])

    def _squares(self, parts: list[Gaussians], camera: Camera, truth: NDArray[np.floating]) -> NDArray[np.floating]:
        if not parts:
            return np.square(truth - np.asarray(camera.background, truth.dtype))
        return np.square(np.clip(render(joined(parts), camera).rgb, 0, 1) - truth)


def savings(rows: Iterable[dict[str, Any]]) -> dict[str, list[float | None]]:
    """By rule, the share of the bytes of the whole package that each row saves at its PSNR; None out of its range.

    Bytes of the whole package in between its rungs: logarithms, linear over PSNR.
    """
    table = list(rows)
    whole = sorted((row["psnr"], row["bytes"]) for row in table if row["rule"] == WHOLE)
    psnr, size = np.array([p for p, _ in whole]), np.array([b for _, b in whole], np.float64)
    found: dict[str, list[float | None]] = {}
    for row in table:
        inside = psnr[0] <= row["psnr"] <= psnr[-1]
        same = math.exp(float(np.interp(row["psnr"], psnr, np.log(size))))
        found.setdefault(row["rule"], []).append(1 - row["bytes"] / same if inside else None)
    return found
