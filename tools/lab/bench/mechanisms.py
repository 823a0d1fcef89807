"""What each mechanism of the encoder buys: scenes encoded as they are, and without one mechanism after the other.

Pictures that no decision has seen measure: from held-out cameras, or from views of a file of their own. The encoder as
it is runs at several qualities, which give its bytes as a function of PSNR; a mechanism saves what the package without
it takes more than the encoder as it is for the same PSNR. Bytes are those of the top rung with all tables, time is CPU
time of the whole encode by one thread. A mechanism earns its lines that brings LEAST_BYTES, LEAST_DB or LEAST_TIME on
two scenes; others are here because nobody could do without them.
"""

from __future__ import annotations

import ast
import os
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from unittest.mock import patch

import numpy as np

import airgs_codec
from airgs_codec import EncodeSettings, decode, encode, open_package, open_sequence
from airgs_codec._sampling import evenly_spaced
from airgs_codec.encoder import batch, level, omit, pipeline, plan, repair, sample
from airgs_codec.encoder.plan import WrittenRows
from airgs_codec.inspect.summary import rung_bytes
from airgs_codec.media.metrics import mse, psnr
from airgs_codec.package.tables import pack_matrix
from airgs_codec.render import read_cameras, render
from tools.lab import Lab, Page, Row, Section, Table, content, listed, required, setting
from tools.lab.made import name_of

LEAST_BYTES, LEAST_DB, LEAST_TIME = 2.0, 0.3, 20.0  # per cent of the bytes, dB, per cent of the time
QUALITIES = (0.8, 1.0, 1.25)  # of the encoder as it is
FRAMES = 6  # of a scene, evenly spaced, that measure
PLAIN = EncodeSettings(threads=1)
COLUMNS = {
    "mechanism": ("mechanism", ""), "lines": ("lines", ""), "scene": ("scene", ""),
    "bytes": ("bytes without it, %", "+.1f"), "psnr": ("PSNR without it, dB", "+.2f"),
    "seconds": ("time without it, %", "+.0f"),
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Options:
    scenes: tuple[str, ...] = required("SCENE[=CAMERAS][@VIEWS]: VIEWS measure, by default the held-out CAMERAS")
    only: tuple[str, ...] = setting((), "of the mechanisms, by default all")


Off = Callable[[EncodeSettings, ExitStack], EncodeSettings]  # switches a mechanism off while the stack is open


@dataclass(frozen=True, slots=True)
class Mechanism:
    name: str
    code: str  # where it is: modules, of the encoder or FOLDER/MODULE, and functions and classes as MODULE:NAME
    off: Off

    @property
    def lines(self) -> int:
        return sum(map(_lines, self.code.split()))


def _lines(where: str) -> int:
    module, _, name = where.partition(":")
    path = Path(airgs_codec.__file__).parent / (module if "/" in module else f"encoder/{module}")
    text = path.with_suffix(".py").read_text(encoding="utf-8")
    nodes = [node for node in ast.walk(ast.parse(text)) if name and getattr(node, "name", "") == name]
    return sum(len((ast.get_source_segment(text, node) or "").splitlines()) for node in nodes) or text.count("\n")


def _set(**changes: Any) -> Off:
    return lambda settings, _: replace(settings, **changes)


def _patched(*patches: tuple[Any, str, Any]) -> Off:
    def off(settings: EncodeSettings, stack: ExitStack) -> EncodeSettings:
        for owner, name, value in patches:
            stack.enter_context(patch.object(owner, name, value))
        return settings

    return off


def _free(of: Any) -> tuple[Any, str, Any]:
    choose = of.planes
    return of, "planes", lambda self, price: choose(self, 0.0)


def _identity(frame: Any, *_: Any) -> str:
    return pack_matrix(np.eye(3 * (1 + frame.sh_rest.shape[1])))


MECHANISMS = (
    Mechanism("keyframes as differences", "keys:lay_out_again pipeline:code_difference", _set(keys="apart")),
    Mechanism(
        "Gaussians of later groups in a keyframe", "pipeline:with_rows_of_others survey:join_surveys",
        _patched((batch, "with_rows_of_others", lambda needed: (next(iter(needed)), 1))),
    ),
    Mechanism("trial encodes", "calibrate sample", _set(calibrate="none")),
    Mechanism(
        "levels by trial", "calibrate:choose_levels calibrate:choose_shares calibrate:Withholding",
        _set(calibrate="steps"),
    ),
    Mechanism(
        "slopes of linear motion", "level sample:worth_line sample:with_line sample:fit_slopes",
        _patched((level, "worth_line", lambda *_: False), (sample, "worth_line", lambda *_: False)),
    ),
    Mechanism(
        "one motion class for what moves together", "coding/motion:share_class",
        _patched((plan, "share_class", lambda classes, *_: classes)),
    ),
    Mechanism(
        "colour transform", "coding/channels:colour_transform coding/channels:fit_colour_transform",
        _patched((plan, "colour_transform", _identity), (sample, "colour_transform", _identity)),
    ),
    Mechanism(
        "steps of each key tier", "plan:tier_factors",
        _patched((plan, "tier_factors", lambda weights, tiers, count: (1.0,) * count)),
    ),
    Mechanism(
        "Gaussians that nobody sees are left out", "plan:keep_rows analysis/importance:RowPruning",
        _patched((pipeline, "keep_rows", lambda frames, *_: WrittenRows.all(len(frames[0])))),
    ),
    Mechanism(
        "SH bands are left out", "omit:omit_bands",
        _patched((pipeline, "omit_bands", lambda sequence, *_: (sequence.sh_degree, None))),
    ),
    Mechanism(
        "planes are left out", "omit:KeyOmissions omit:planes",
        _patched(*(_free(of) for of in (omit.KeyOmissions, omit.StateOmissions))),
    ),
    Mechanism("Gaussians ranked by importance", "analysis/importance:importance", _set(usage="max")),
    Mechanism("updates ranked by expected error", "coding/motion:withheld_error", _set(update_rank="usage")),
    Mechanism("what costs too much is taken back", "repair", _patched((repair, "take_back", lambda *_: None))),
)  # fmt: skip


def run(options: Options, lab: Lab) -> Page:
    known = [one.name for one in MECHANISMS]
    chosen = [one for one in MECHANISMS if one.name in (options.only or known)]
    rows: list[Row] = []
    for scene in options.scenes:
        curve = [_once(scene, replace(PLAIN, quality=quality), None, lab) for quality in QUALITIES]
        for one in chosen:
            rows.append(row_of(one, name_of(scene.partition("@")[0]), curve, _once(scene, PLAIN, one, lab)))
    rows.sort(key=lambda row: known.index(row["mechanism"]))
    return Page([Section(answer(rows), tables=[Table("mechanisms", rows, COLUMNS)])])


Result = tuple[float, float, float]  # bytes a frame of the top rung, dB of held-out views, CPU seconds


def row_of(one: Mechanism, scene: str, curve: Sequence[Result], got: Result) -> Row:
    """What a scene takes without a mechanism, in per cent of what it takes as it is for the same PSNR, or time."""
    sizes, quality = [np.log(size) for size, _, _ in curve], [shown for _, shown, _ in curve]
    return {
        "mechanism": one.name, "lines": one.lines, "scene": scene,
        "bytes": 100 * (got[0] / float(np.exp(_along(quality, sizes, got[1]))) - 1),
        "psnr": got[1] - _along(sizes, quality, float(np.log(got[0]))),
        "seconds": 100 * (got[2] / curve[QUALITIES.index(1.0)][2] - 1),
    }  # fmt: skip


def _along(xs: Sequence[float], ys: Sequence[float], x: float) -> float:
    """The value at x of the line through the two nearest of some points, which goes on past them."""
    at, of = np.array(sorted(zip(xs, ys, strict=True))).T
    k = int(np.clip(np.searchsorted(at, x) - 1, 0, len(at) - 2))
    return float(of[k] + (of[k + 1] - of[k]) * (x - at[k]) / (at[k + 1] - at[k]))


def _once(scene: str, settings: EncodeSettings, one: Mechanism | None, lab: Lab) -> Result:
    reads = (scene, content(Path(scene.partition("@")[0].partition("=")[0])), settings.quality, one and one.name)
    return lab.results.once("mechanism", reads, lambda: _encoded(scene, settings, one))


def _encoded(scene: str, settings: EncodeSettings, one: Mechanism | None) -> Result:
    """Encode a scene with nothing calibrated before, and measure what comes out from held-out views."""
    place, _, held = scene.partition("@")
    place, _, views = place.partition("=")
    sequence = open_sequence(place, views=views or None)
    cameras = list(read_cameras(Path(held))) if held else [c for c in sequence.cameras if c.held_out]
    with TemporaryDirectory(prefix="airgs-") as folder, ExitStack() as stack:
        stack.enter_context(patch.dict(os.environ, {"XDG_CACHE_HOME": folder}))
        settings = one.off(settings, stack) if one else settings
        begun = time.process_time()
        encode(sequence, Path(folder) / "x.airgs", settings)
        seconds = time.process_time() - begun
        package = open_package(Path(folder) / "x.airgs")
        errors = []
        for number in evenly_spaced(len(sequence), FRAMES):
            shown, original = decode(package, number), sequence.load([number]).frames[0]
            errors += [mse(render(shown, camera).rgb, render(original, camera).rgb) for camera in cameras]
        size = rung_bytes(package.manifest, 0, 0, package.manifest_bytes) / package.manifest.frames
    return size, psnr(float(np.mean(errors))), seconds


def answer(rows: Sequence[Row]) -> str:
    names = dict.fromkeys(row["mechanism"] for row in rows)
    counts = {name: sum(_earns(row) for row in rows if row["mechanism"] == name) for name in names}
    enough, others = ([name for name, count in counts.items() if (count >= 2) == there] for there in (True, False))
    told = f"Of {len(counts)} mechanisms {len(enough)} bring enough on two scenes or more"
    return f"{told}; {listed(others)} do not." if others else f"{told}."


def _earns(row: Row) -> bool:
    return row["bytes"] >= LEAST_BYTES or row["psnr"] <= -LEAST_DB or row["seconds"] >= LEAST_TIME
