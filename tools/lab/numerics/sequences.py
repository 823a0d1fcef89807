"""Sequences at the ends of what float32 and people put into .ply files, and what becomes of each.

`measure_case` sends one through the encoder, and compares what is decoded with what the package promises.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from airgs_codec.decoder.decode import decode_frames
from airgs_codec.encoder.publish import encode
from airgs_codec.encoder.settings import EncodeSettings, LevelSettings
from airgs_codec.errors import AirgsError
from airgs_codec.inspect.errors import measure_errors
from airgs_codec.inspect.validate import validate
from airgs_codec.package.package import open_package
from airgs_codec.scene.camera import orbit_views
from airgs_codec.scene.formats.ply import write_ply
from airgs_codec.scene.gaussians import SH_REST, Gaussians
from airgs_codec.scene.sequence import GaussianSequence, open_sequence

PLAIN = EncodeSettings(calibrate="none", measure_pictures=0, preset="ultrafast", keep_all=True, threads=1)
Frames = list[Gaussians]
TINY = float(np.finfo(np.float32).smallest_subnormal)


def f32(values: Sequence[float]) -> NDArray[np.float32]:
    return np.array(values, np.float32)


def swing(g: Gaussians, frames: int = 4, size: float = 0.1) -> Frames:
    moves = np.outer(np.arange(len(g)) % 2, f32([size, 0, 0])).astype(np.float32)
    return [replace(g, means=g.means + np.float32(np.sin(t)) * moves) for t in range(frames)]


def ball(count: int = 200, degree: int = 0, seed: int = 0) -> Gaussians:
    random = np.random.default_rng(seed)
    size = np.log(0.6 / max(count, 2) ** (1 / 3))
    columns = [random.normal(size=(count, 3)) * 0.5, random.normal(size=(count, 4))]
    columns += [size + random.normal(size=(count, 3)) * 0.4, random.normal(size=count) * 2]
    columns += [random.normal(size=(count, 3)) * 0.6, random.normal(size=(count, SH_REST[degree], 3)) * 0.1]
    return Gaussians(*(column.astype(np.float32) for column in columns))


def changed(name: str, value: np.ndarray | float, rows: slice = slice(None), **options: int) -> Callable[[], Frames]:

    def build() -> Frames:
        g = ball(**options)
        getattr(g, name)[rows] = value
        return swing(g)

    return build


def _stretched() -> Frames:
    g = ball()
    g.log_scales[:] = np.log(f32([1e-6, 1e-3, 1.0]))
    return swing(g)


def _collinear() -> Frames:
    g = ball()
    g.means[:] = np.linspace(-1, 1, len(g), dtype=np.float32)[:, None] * f32([1, 0, 0])
    return swing(g)


def _coincident() -> Frames:
    g = ball()
    g.means[:] = 0.25
    return swing(g)


def _equal() -> Frames:
    g = ball()
    return swing(g.take(np.zeros(len(g), np.intp)), size=0.0)


def _far() -> Frames:
    g = ball()
    return [replace(f, means=(1e6 + 1e-3 * f.means.astype(np.float64)).astype(np.float32)) for f in swing(g)]


def _jump(every: int) -> Frames:
    """Rows that are 1e4 steps away, in one frame of six or in every second one."""
    g = ball(100)
    frames = [replace(g, means=g.means.copy()) for _ in range(6)]
    for t, frame in enumerate(frames):
        if t and t % every == 0:
            frame.means[::2] += 30.0
    return frames


def _all_jump(tracked: bool) -> Frames:
    """Every channel of every row jumps every frame; `tracked`: the second frame as a whole, which keeps it a group."""
    random = np.random.default_rng(1)
    g = ball(60, 1)
    frames = []
    for t in range(8):
        other = ball(60, 1, int(random.integers(1 << 30)))
        away = np.full_like(g.means, 20.0) if tracked and t == 1 else 20 * other.means
        frames.append(replace(other, means=g.means + away if t else g.means, sh_dc=10 * other.sh_dc))
    return frames


def _checkerboard() -> Frames:
    g = ball()
    odd = np.arange(len(g)) % 2
    return [replace(g, opacity_logits=np.where((odd + t) % 2, 8.0, -8.0).astype(np.float32)) for t in range(6)]


def _constant() -> Frames:
    g = ball()
    for name in ("log_scales", "opacity_logits", "sh_dc"):
        getattr(g, name)[:] = 0.5
    g.quaternions[:] = (1, 0, 0, 0)
    return swing(g)


def _broken(name: str, value: float) -> Callable[[], Frames]:
    """One row of one frame is not finite: it is dropped in all of them, and the package says so."""

    def build() -> Frames:
        frames = [replace(f, **{name: getattr(f, name).copy()}) for f in swing(ball(50, 1))]
        getattr(frames[1], name)[7] = value
        return frames

    return build


def _sized(count: int) -> Frames:
    return swing(ball(count), 2)


def _hopeless() -> Frames:
    g = ball(20)
    g.means[:] = np.nan
    return swing(g)


@dataclass(frozen=True)
class Case:
    """A sequence, how it is encoded, and a word of the refusal if it must be refused."""

    name: str
    frames: Callable[[], Frames]
    settings: EncodeSettings = PLAIN
    refused: str = ""
    repaired: str = ""
    search: bool = False  # come without cameras: where it is seen from is found, too


LEVELS = tuple(LevelSettings(i / 64, 1 + i / 16) for i in range(64))
CASES = [
    Case("scale ratios of 1e6", _stretched), Case("log-scales of -30", changed("log_scales", -30.0)),
    Case("log-scales of +30", changed("log_scales", 30.0), search=True),
    Case("log-scales of -30, 0 and 30 in one Gaussian", changed("log_scales", f32([-30, 0, 30]))),
    Case("opacity logits of -100 and +100", changed("opacity_logits", f32([-100, 100] * 100))),
    Case("opacity logits of -inf and +inf", changed("opacity_logits", f32([-np.inf, np.inf] * 100))),
    Case("zero quaternions", changed("quaternions", 0.0, slice(0, 50)), repaired="zero quaternions"),
    Case("quaternions of length 1e-30", changed("quaternions", 1e-30, slice(0, 50)), repaired="zero quaternions"),
    Case("quaternions of length 1e30", changed("quaternions", f32([0, 1e30, 0, 0]))),
    Case("half turns", changed("quaternions", f32([0, 1, 0, 0]))), Case("all at one point", _coincident, search=True),
    Case("all on one line", _collinear, search=True), Case("all Gaussians equal", _equal),
    Case("one Gaussian", lambda: swing(ball(1)), search=True), Case("one frame", lambda: [ball()]),
    Case("1000 frames", lambda: swing(ball(20), 1000)),
    Case("1e6 from the origin, details of 1e-3", _far, search=True),
    Case("a jump of 1e4 steps in one frame", lambda: _jump(3)),
    Case("a jump of 1e4 steps every second frame", lambda: _jump(2)),
    Case("every channel jumps every frame", lambda: _all_jump(True), replace(PLAIN, rows="keep")),
    Case("the same from the second frame on: not tracked", lambda: _all_jump(False), repaired="rows are not those"),
    Case("opacity a checkerboard in time", _checkerboard), Case("SH DC of 1000", changed("sh_dc", 1e3)),
    Case("SH rest of 1000, alternating", changed("sh_rest", f32([1e3, -1e3, 1e3]), degree=3)),
    Case("constant channels", _constant), Case("subnormal SH and quaternions", changed("sh_dc", TINY)),
    *(Case(f"{n} Gaussians", partial(_sized, n)) for n in (15, 17, 255, 256, 257, 4095, 4096, 4097)),
    Case("64 levels", lambda: swing(ball()), replace(PLAIN, levels=LEVELS)),
    Case("64 keyframe tiers", lambda: swing(ball()), replace(PLAIN, tiers=(1 / 64,) * 64)),
    Case("more tiers than Gaussians", lambda: swing(ball(3)), replace(PLAIN, tiers=(1 / 16,) * 16)),
    *(
        Case(
            f"{value} in {name}",
            _broken(name, value),
            repaired="1 Gaussians that are not finite",
            search=name == "means",
        )
        for name in ("means", "quaternions", "log_scales", "opacity_logits", "sh_dc", "sh_rest")
        for value in ((np.nan,) if name == "opacity_logits" else (np.nan, np.inf))
    ),
    Case("no finite Gaussian", _hopeless, refused="expected finite Gaussians", search=True),
    Case("means of 1e38", changed("means", 1e38, slice(0, 1)), search=True),
    Case("log-scales of 1e30", changed("log_scales", 1e30, slice(0, 1)), refused="expected at most"),
    Case("SH of 1e30", changed("sh_dc", 1e30, slice(0, 1)), refused="expected at most"),
]  # fmt: skip


@dataclass(frozen=True)
class Outcome:
    name: str
    refusal: str = ""
    worst: float = 0.0  # largest error over its bound, over attributes and atlases
    attribute: str = ""  # where that was
    error: float = 0.0
    bound: float = 0.0
    compared: int = 0  # rows
    bytes_a_gaussian: float = 0.0  # of the top rung, a frame
    repairs: str = ""
    finite: bool = True


def written(case: Case, folder: Path) -> GaussianSequence:
    """Its frames in a new folder, with cameras but for those that an encode is to find."""
    folder.mkdir()
    frames = case.frames()
    for number, frame in enumerate(frames):
        write_ply(folder / f"{number:06d}.ply", frame)
    cameras = () if case.search else tuple(orbit_views(frames[0], count=4, size=64))
    return replace(open_sequence(folder), cameras=cameras)


def measure_case(case: Case, folder: Path) -> Outcome:
    """Encode into `folder`, validate, decode, and compare with the promises. A package that is not valid raises."""
    sequence = written(case, folder / "scene")
    try:
        encode(sequence, folder / "out", case.settings)
    except AirgsError as error:
        assert not (folder / "out").exists()
        return Outcome(case.name, str(error).replace(f"{folder}/", ""))
    findings = validate(folder / "out")
    assert not findings, findings
    package = open_package(folder / "out")
    m = package.manifest
    finite = all(
        np.isfinite(getattr(frame.gaussians, name)).all()
        for frame in decode_frames(package, 0, m.frames)
        for name in frame.gaussians.__slots__
    )
    measured = list(measure_errors(package, sequence))
    top = [e for e in measured if "Q0" in e.where or "L0" in e.where]
    worst = max(top, key=lambda e: e.error / e.bound if e.bound else float(e.error > 0))
    rows = sum(g.count for g in m.groups)
    size = m.bytes_of(m.rung_files(0, 0)) / m.frames / rows * len(m.groups)
    return Outcome(
        case.name,
        "",
        max((e.error / e.bound if e.bound else float(e.error > 0)) for e in measured),
        f"{worst.attribute} of {worst.where}",
        worst.error,
        worst.bound,
        sum(e.rows for e in measured) // len(measured) if measured else 0,
        size,
        "; ".join([*(line for group in m.groups for line in group.repairs), *m.decisions]),
        finite,
    )
