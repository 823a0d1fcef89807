"""Sessions of a viewer over a scene as one package and in tiles, and what tiles save at equal quality on the screen.

Viewers turn at a pace that nobody knows in advance; their times are seconds after the first picture.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from airgs_codec.package.package import Package
from airgs_codec.package.tables import Region
from airgs_codec.package.viewpath import Path, path_of_region
from airgs_codec.play.offers import Offers
from airgs_codec.play.session import SessionLog, simulate
from airgs_codec.play.settings import SessionSettings
from airgs_codec.play.sight import View
from airgs_codec.play.trace import Link, Trace
from airgs_codec.scene.camera import Camera
from tools.lab.page import Row

WHOLE, TILED, BY_VIEW = "one package", "all tiles", "by view"
AMPLE = "ample"
PACE = 2.0  # seconds of the walk in a second, on average
Swing = tuple[float, float, float]  # seconds of the walk by which he runs ahead or behind; period; phase
SWINGS: tuple[Swing, ...] = ((3.0, 5.3, 0.0), (1.2, 1.9, 1.0))
HELD_OUT_SEED = 7
VIEWERS: dict[str, float] = {"lively": 1.0, "calm": 0.3, "even": 0.0}  # name -> factor on the swings
HELD_OUT = "held out"  # a viewer that no constant was chosen by


@dataclass(frozen=True, slots=True)
class Watcher:
    """The walk of a viewer through a region, as a `play.sight.View`."""

    path: Path
    swings: Sequence[Swing] = SWINGS

    @staticmethod
    def of(region: Region, name: str) -> Watcher:
        """One of VIEWERS, or the one that is HELD_OUT: other swings, drawn from a seed."""
        path = path_of_region(region)
        if name == HELD_OUT:
            return Watcher(path, drawn_swings(HELD_OUT_SEED))
        return Watcher(path, [(VIEWERS[name] * ahead, period, phase) for ahead, period, phase in SWINGS])

    def at(self, seconds: float) -> Camera:
        """What he sees at a moment."""
        place = PACE * seconds
        for ahead, period, phase in self.swings:
            place += ahead * (np.sin(2 * np.pi * seconds / period + phase) - np.sin(phase))
        return self.path.at(place)

    def turning(self, seconds: float, rate: int = 50) -> float:
        """Degrees a second that he turns at, the 95th percentile over a time."""
        axes = np.array([self.at(tick / rate).world_to_camera[2, :3] for tick in range(round(seconds * rate))])
        cosines = np.clip((axes[1:] * axes[:-1]).sum(axis=1), -1, 1)
        return float(np.percentile(np.degrees(np.arccos(cosines)) * rate, 95))


def drawn_swings(seed: int) -> list[Swing]:
    """Two swings about as strong as SWINGS, a slow one and a quick one."""
    rng = np.random.default_rng(seed)
    slow = float(rng.uniform(1.5, 3.0)), float(rng.uniform(4.0, 7.0)), float(rng.uniform(0, 2 * np.pi))
    quick = float(rng.uniform(0.5, 1.2)), float(rng.uniform(1.5, 2.5)), float(rng.uniform(0, 2 * np.pi))
    return [slow, quick]


@dataclass(frozen=True, eq=False)
class Bench:
    """The packages of a scene and the rules of its player."""

    whole: Package
    tiled: Package
    settings: SessionSettings

    def rate_bps(self, level: int) -> float:
        """Rate of a level with its own keys, of the one package."""
        log = self._play(self.whole, level, Link(Trace.open("const:1000"), 0.0))
        return 8 * log.metrics.wire_bytes / log.metrics.played_s

    def sessions(self, level: int, links: dict[str, Link], view: View) -> Iterator[tuple[str, str, SessionLog]]:
        """(link, how, log) of a level with its own keys over each link: one package, all tiles, tiles by view."""
        for name, link in links.items():
            yield name, WHOLE, self._play(self.whole, level, link)
            yield name, TILED, self._play(self.tiled, level, link)
            yield name, BY_VIEW, self._play(self.tiled, level, link, view)

    def _play(self, package: Package, level: int, link: Link, view: View | None = None) -> SessionLog:
        entry = package.manifest.levels[level]
        policy = f"fixed:{package.manifest.qualities[entry.quality].id}+{entry.id}"
        return simulate(Offers.of(package), link, policy, self.settings, view=view)


def links_of(rate_bps: float, times: Sequence[float], trace: str | None, seconds: float) -> dict[str, Link]:
    """Constant links of so many times a rate, and a trace scaled so that its first seconds carry as much."""
    found = {f"{n:g} x": Link(Trace.open(f"const:{n * rate_bps / 1e6}")) for n in times}
    if trace is not None:
        recorded = Trace.open(trace)
        carried_bps = recorded.bits_until(seconds) / seconds
        for n in times:
            found[f"{recorded.name}, {n:g} x"] = Link.over(recorded.cut(0.0, n * rate_bps / carried_bps))
    return found


def row_of(link: str, how: str, level: int, log: SessionLog) -> Row:
    """The figures of a session but for those of its pictures."""
    m = log.metrics
    row: Row = {"link": link, "how": how, "rung": level, "bytes": m.wire_bytes, "seconds": m.played_s}
    row |= {"stalls": m.stalls, "stall_s": m.stall_s, "startup_s": m.startup_s, "wasted": m.wasted}
    if m.tiles is not None:
        repaired = sum(f.bytes for f in log.fetches if f.kind == "repair")
        row |= {"fetched": m.tiles.fetched, "late": m.tiles.late, "missing_s": m.tiles.missing_s}
        row |= {"repaired": repaired / m.wire_bytes}
    return row


def add_savings(rows: Iterable[Row]) -> None:
    """To every row with a quality the share of the bytes that it saves against one package of that quality.

    Bytes of the one package in between its rungs: logarithms, linear over PSNR. None out of their range.
    """
    table = [row for row in rows if "psnr" in row]
    curve = {row["psnr"]: row["bytes"] for row in table if row["how"] == WHOLE and not row["stalls"]}
    known = sorted(curve.items())
    psnr, size = np.array([p for p, _ in known]), np.array([b for _, b in known], np.float64)
    for row in table:
        row["saved"] = None
        if len(known) and psnr[0] - 1e-9 <= row["psnr"] <= psnr[-1] + 1e-9:
            row["saved"] = 1 - row["bytes"] / math.exp(float(np.interp(row["psnr"], psnr, np.log(size))))
