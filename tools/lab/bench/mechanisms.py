"""What each mechanism buys: scenes encoded or trained as they are, and without one mechanism after the other.

Pictures that no decision has seen measure: from held-out cameras, or from views of a file of their own. The encoder as
it is runs at several qualities, which give its bytes as a function of PSNR; a mechanism saves what the package without
it takes more than the encoder as it is for the same PSNR. Bytes are those of the top rung with all tables, time is CPU
time of the whole encode by one thread. A mechanism earns its lines that brings LEAST_BYTES, LEAST_DB or LEAST_TIME on
two scenes; others are here because nobody could do without them.

Frames of multi-view video are trained in SPLITS of their cameras, in pictures of at most SIDE pixels. PSNR is that of
held-out cameras, each picture after the gain and offset of its colours that fit best. Bytes are those of a package of
what was trained, by the encoder's defaults. What acts behind the first frame alone goes on from the same first frame,
and its time is that of the frames behind. Mechanisms for sparse rigs, or for cameras that are not in step, have no row
where a scene is neither. What other random numbers do is no mechanism, but says what is chance.
"""

from __future__ import annotations

import ast
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any
from unittest.mock import patch

import numpy as np

import airgs_codec
from airgs_codec import EncodeSettings, decode, encode, open_package, open_sequence
from airgs_codec._sampling import evenly_spaced
from airgs_codec.analysis.importance import WrittenRows
from airgs_codec.encoder import decide, layout, omit, publish, sample
from airgs_codec.encoder.sample import CalibrationSample
from airgs_codec.encoder.survey import Survey
from airgs_codec.errors import ConfigError
from airgs_codec.media.metrics import mse, psnr
from airgs_codec.package.package import Package
from airgs_codec.progress import Progress, silent
from airgs_codec.render import read_cameras, render
from airgs_codec.trainer import pipeline as training
from airgs_codec.trainer.data.multiview import MultiviewScene, with_held_out
from airgs_codec.trainer.data.readers import open_scene
from airgs_codec.trainer.data.sync import find_offsets, in_step
from airgs_codec.trainer.fit import trainer as frame_fit
from airgs_codec.trainer.fit.points import SPARSE_DEGREES, degrees_apart
from airgs_codec.trainer.fit.trainer import Trainer
from airgs_codec.trainer.frames import Capture, train_first
from airgs_codec.trainer.record import TrainedFrame
from airgs_codec.trainer.settings import Temporal, TrainSettings
from tools.lab import Lab, Page, PagePicture, Row, Section, Table, content, required, setting
from tools.lab.made import name_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LEAST_BYTES, LEAST_DB, LEAST_TIME = 2.0, 0.3, 20.0  # per cent of the bytes, dB, per cent of the time
QUALITIES = (0.8, 1.0, 1.25)  # of the encoder as it is
FRAMES = 6  # of a scene, evenly spaced, that measure
SPLITS, SIDE, SEED = (0, 1), 320, 2  # of cameras; pixels; of the order in which cameras are dealt out
PLAIN = EncodeSettings(threads=1)
COLUMNS = {
    "mechanism": ("mechanism", ""), "lines": ("lines", ""), "scene": ("scene", ""),
    "bytes": ("bytes without it, %", "+.1f"), "psnr": ("PSNR without it, dB", "+.2f"),
    "seconds": ("time without it, %", "+.0f"),
}  # fmt: skip
SUMMARY = {
    "mechanism": ("mechanism", ""), "lines": ("lines", ""), "enough": ("enough on", ""), "of": ("of", ""),
    "bytes_least": ("bytes, least, %", "+.1f"), "bytes_most": ("most, %", "+.1f"),
    "psnr_least": ("PSNR, least, dB", "+.2f"), "psnr_most": ("most, dB", "+.2f"),
    "seconds_least": ("time, least, %", "+.0f"), "seconds_most": ("most, %", "+.0f"),
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Options:
    scenes: tuple[str, ...] = required(
        "SCENE[=CAMERAS][@VIEWS]: VIEWS measure, by default the held-out CAMERAS; SCENE:A:B: frames A to B to train on"
    )
    only: tuple[str, ...] = setting((), "of the mechanisms, by default all")


Off = Callable[[Any, ExitStack], Any]  # switches a mechanism off while the stack is open; gives the settings for it


@dataclass(frozen=True, slots=True)
class Mechanism:
    name: str
    code: str  # where it is: modules, of the encoder or FOLDER/MODULE, and functions and classes as MODULE:NAME
    off: Off
    behind: bool = False  # whether it acts behind the first frame of a training alone
    needs: str = ""  # of `Rig.kinds`

    @property
    def lines(self) -> int:
        return sum(map(_lines, self.code.split()))


def _lines(where: str) -> int:
    module, _, name = where.partition(":")
    path = Path(airgs_codec.__file__).parent / (module if "/" in module else f"encoder/{module}")
    text = path.with_suffix(".py").read_text(encoding="utf-8")
    nodes = [node for node in ast.walk(ast.parse(text)) if name and getattr(node, "name", "") == name]
    assert nodes or not name, f"{where}: expected a function or a class of this name"
    return sum(len((ast.get_source_segment(text, node) or "").splitlines()) for node in nodes) or text.count("\n")


def _set(**changes: Any) -> Off:
    return lambda settings, _: replace(settings, **changes)


def _patched(*patches: tuple[Any, str, Any]) -> Off:
    def off(settings: Any, stack: ExitStack) -> Any:
        for owner, name, value in patches:
            stack.enter_context(patch.object(owner, name, value))
        return settings

    return off


def _both(*offs: Off) -> Off:
    def off(settings: Any, stack: ExitStack) -> Any:
        for one in offs:
            settings = one(settings, stack)
        return settings

    return off


def _free(of: Any) -> tuple[Any, str, Any]:
    choose = of.planes
    return of, "planes", lambda self, price: choose(self, 0.0)


def _identity(frame: Any, *_: Any) -> Any:
    return np.eye(3 * (1 + frame.sh_rest.shape[1]))


MECHANISMS = (
    Mechanism(
        "keyframes as differences", "layout:lay_out_again layout:error_with keyframes:_code_difference",
        _set(keyframes="intra"),
    ),
    Mechanism(
        "Gaussians of later groups in a keyframe", "survey:joined",
        _patched((publish, "choose", partial(decide.choose, run=0))),
    ),
    Mechanism("trial encodes", "steps sample", _set(calibrate="none")),
    Mechanism(
        "levels by trial", "steps:choose_levels steps:choose_shares steps:Withholding",
        _set(calibrate="steps"),
    ),
    Mechanism(
        "slopes of linear motion", "deltas:CodedSlopes deltas:_write_rest sample:with_slopes",
        _patched((CalibrationSample, "with_slopes", lambda self, *_: self)),
    ),
    Mechanism(
        "one motion class for what moves together", "coding/motion:share_class",
        _patched((layout, "share_class", lambda classes, *_: classes)),
    ),
    Mechanism(
        "colour transform", "coding/channels:colour_transform coding/channels:fit_colour_transform",
        _patched((layout, "colour_transform", _identity), (sample, "colour_transform", _identity)),
    ),
    Mechanism(
        "steps of each keyframe tier", "layout:tier_factors",
        _patched((layout, "tier_factors", lambda weights, tiers, count: (1.0,) * count)),
    ),
    Mechanism(
        "Gaussians that nobody sees are left out", "survey:needed analysis/importance:RowPruning",
        _patched((Survey, "needed", lambda self, _: WrittenRows.all(len(self.importance)))),
    ),
    Mechanism(
        "SH bands are left out", "omit:omit_bands",
        _patched((decide, "omit_bands", lambda frames, *_: (frames.sequence.sh_degree, ""))),
    ),
    Mechanism(
        "planes are left out", "omit:KeyframeOmissions omit:planes",
        _patched(*(_free(of) for of in (omit.KeyframeOmissions, omit.DeltaOmissions))),
    ),
    Mechanism("Gaussians ranked by importance", "analysis/importance:importance", _set(usage="max")),
    Mechanism("updates ranked by expected error", "coding/motion:withheld_error", _set(update_rank="usage")),
)  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class Rig:
    """Frames that are trained on in one split of their cameras; `offsets`: frames that cameras are late."""

    scene: MultiviewScene
    span: tuple[int, int]
    held_out: tuple[str, ...]
    offsets: dict[str, float]

    @property
    def kinds(self) -> set[str]:
        """What is true of it, of what mechanisms need."""
        cameras = [camera for camera in self.seen().cameras if not camera.held_out]
        kinds = {"": True, SPARSE: degrees_apart(cameras) > SPARSE_DEGREES, LATE: bool(self.offsets)}
        return {name for name, there in kinds.items() if there}

    def seen(self) -> MultiviewScene:
        """The frames; whatever cameras that are trained on are taken for, those that measure are in step."""
        late = {name: offset for name, offset in self.taken_late().items() if name not in self.held_out}
        late |= {name: offset for name, offset in self.offsets.items() if name in self.held_out}
        return with_held_out(in_step(self.scene, late, self.span), self.held_out)

    def taken_late(self) -> dict[str, float]:
        return self.offsets


SPARSE, LATE = "few cameras far apart", "cameras that are not in step"
FIT, DATA = "trainer/fit/", "trainer/data/"
CONTROL = "nothing but other random numbers"
OF_TRAINING = (
    Mechanism(CONTROL, "", _set(seed=1)),
    Mechanism(
        "walls around a sparse rig", f"{FIT}points:sparse_cloud",
        _patched((frame_fit, "sparse_cloud", lambda *_: None)), needs=SPARSE,
    ),
    Mechanism("dropout in a sparse rig", "", _patched((frame_fit, "DROPOUT", 0.0)), needs=SPARSE),
    Mechanism("cameras are brought into step", f"{DATA}sync", _patched((Rig, "taken_late", lambda _: {})), needs=LATE),
    Mechanism(
        "pictures between frames", f"{FIT}losses:with_motion",
        _patched((Rig, "taken_late", lambda rig: {n: float(round(v)) for n, v in rig.offsets.items()})), needs=LATE,
    ),
    Mechanism("what rests stays", f"{DATA}pictures:settle {FIT}trainer:find_active", _set(static="off")),
    Mechanism(
        "only what may change is fitted", f"{FIT}trainer:find_active",
        _patched((Trainer, "_scope", lambda trainer, before, target, base: (target.views, None))), behind=True,
    ),
    Mechanism("exposure of cameras", f"{FIT}optimise:ExposureModel", _set(match_exposure="off")),
    Mechanism("empty space stays empty", f"{FIT}optimise:_regularise", _set(regularised=False)),
    Mechanism(
        "motion goes on", f"{FIT}trainer:_is_foreseen {FIT}trainer:_start", _set(velocity=False), behind=True
    ),
    Mechanism("coarse pictures first", f"{FIT}optimise:halve", _set(coarse=0.0), behind=True),
    Mechanism("temporal loss", f"{FIT}losses:temporal_weights", _set(temporal=Temporal(weight=0.0)), behind=True),
    Mechanism("only what is better is taken", f"{FIT}losses:better", _set(keep_better=False), behind=True),
    Mechanism(
        "new Gaussians where pictures are wrong", f"{FIT}grow:residual_seeds {FIT}grow:find_wrong", _set(seeds=False),
        behind=True,
    ),
    Mechanism(
        "keyframes from the frame before", f"{FIT}trainer:fit_keyframe",
        _patched((Trainer, "fit_keyframe", lambda t, target, *_: frame_fit.fit_first(t, target, None))), behind=True,
    ),
)  # fmt: skip


def run(options: Options, lab: Lab) -> Page:
    known = [one.name for one in (*MECHANISMS, *OF_TRAINING)]
    if not set(options.only) <= set(known):
        raise ConfigError(f"--only: expected some of {', '.join(known)}, got {', '.join(options.only)}")
    chosen = [one for one in MECHANISMS if one.name in (options.only or known)]
    rows: list[Row] = []
    for scene in options.scenes:
        if ":" in scene:
            of_training = [one for one in OF_TRAINING if one.name in (options.only or known)]
            rows += [row for split in SPLITS for row in _rows_of_training(scene, split, of_training, lab)]
            continue
        curve = [_once(scene, replace(PLAIN, quality=quality), None, lab) for quality in QUALITIES]
        for one in chosen:
            rows.append(row_of(one, name_of(scene.partition("@")[0]), curve, _once(scene, PLAIN, one, lab)))
    rows.sort(key=lambda row: known.index(row["mechanism"]))
    shown = Table("mechanisms-summary", summary(rows), SUMMARY)
    data, size = [Table("mechanisms", rows, COLUMNS)], (7.0, 1.2 + 0.25 * len(shown.rows))
    caption = "Bytes that scenes take without each mechanism"
    name = f"mechanisms{'-trainer' * any(':' in scene for scene in options.scenes)}"
    picture = PagePicture(name, caption, partial(draw, rows), size)
    return Page([Section("", "", [picture], [shown])], data=data)


def draw(rows: Sequence[Row], figure: Figure) -> None:
    axis, names = figure.subplots(), list(dict.fromkeys(row["mechanism"] for row in rows))
    for scene in dict.fromkeys(row["scene"] for row in rows):
        some = [row for row in rows if row["scene"] == scene]
        axis.plot([row["bytes"] for row in some], [row["mechanism"] for row in some], "o", markersize=5, label=scene)
    axis.set_xscale("symlog", linthresh=10)
    axis.set_ylim(len(names) - 0.5, -0.5)
    axis.set(xlabel="bytes without it, % more at equal PSNR", ylabel="mechanism")
    axis.axvline(0, color="black", linewidth=0.8)
    axis.set_xticks([-10, -5, 0, 5, 10, 20, 50, 100], ["-10", "-5", "0", "5", "10", "20", "50", "100"])
    axis.margins(x=0.1)
    figure.legend(loc="outside upper center", ncols=4)


Result = tuple[float, float, float]  # bytes a frame of the top rung, dB of held-out views, CPU seconds


def row_of(one: Mechanism, scene: str, curve: Sequence[Result], got: Result) -> Row:
    """What a scene takes without a mechanism, in per cent of what it takes as it is for the same PSNR, or time."""
    sizes, quality = [np.log(size) for size, _, _ in curve], [shown for _, shown, _ in curve]
    size, shown = float(np.exp(_along(quality, sizes, got[1]))), _along(sizes, quality, float(np.log(got[0])))
    return _row(one, scene, got, (size, shown, curve[QUALITIES.index(1.0)][2]))


def _row(one: Mechanism, scene: str, got: Result, base: Result) -> Row:
    return {
        "mechanism": one.name, "lines": one.lines, "scene": scene, "bytes": 100 * (got[0] / base[0] - 1),
        "psnr": got[1] - base[1], "seconds": 100 * (got[2] / base[2] - 1),
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
    place, _, held = scene.partition("@")
    place, _, views = place.partition("=")
    sequence = open_sequence(place, views=views or None)
    cameras = list(read_cameras(Path(held))) if held else [c for c in sequence.cameras if c.held_out]
    with TemporaryDirectory(prefix="airgs-") as folder, ExitStack() as stack:
        settings = one.off(settings, stack) if one else settings
        begun = time.process_time()
        encode(sequence, Path(folder) / "x.airgs", settings)
        seconds = time.process_time() - begun
        package = open_package(Path(folder) / "x.airgs")
        errors = []
        for number in evenly_spaced(len(sequence), FRAMES):
            shown, original = decode(package, number), sequence.load([number]).frames[0]
            errors += [mse(render(shown, camera).rgb, render(original, camera).rgb) for camera in cameras]
    return _top_bytes(package), psnr(float(np.mean(errors))), seconds


def _rows_of_training(scene: str, split: int, chosen: Sequence[Mechanism], lab: Lab) -> list[Row]:
    path, start, stop = scene.split(":")
    opened, span = open_scene(Path(path)), (int(start), int(stop))
    reads, name = (content(Path(path)), span, split, SIDE), f"{name_of(path)}:{start}:{stop}/{split}"
    late = lab.results.once("offsets", reads, lambda: find_offsets(opened, span))
    names = [camera.name for camera in opened.cameras]
    some = max(2, len(names) // 5)
    order = np.random.default_rng(SEED).permutation(names).tolist()
    rig = Rig(opened, span, tuple(order[split * some : (split + 1) * some]), late)
    first, whole, behind = lab.results.once("training", reads, lambda: _trained(rig, None, None))
    rows = []
    for one in (one for one in chosen if one.needs in rig.kinds):
        begun = first if one.behind else None
        known = (*reads, one.name)
        _, *got = lab.results.once("training", known, lambda one=one, begun=begun: _trained(rig, one, begun))  # type: ignore[misc]
        rows.append(_row(one, name, *((got[1], behind) if one.behind else (got[0], whole))))
        lab.tell(f"{rows[-1]}")
    return rows


def _trained(rig: Rig, one: Mechanism | None, first: TrainedFrame | None) -> tuple[TrainedFrame, Result, Result]:
    """The first frame, and what all frames take and show with the time of all, and of those behind it."""
    given, times = first, [time.process_time()]

    def begin(capture: Capture, progress: Progress = silent) -> TrainedFrame:
        nonlocal first
        first = given or train_first(capture, progress)
        times.append(time.process_time())
        return first

    with TemporaryDirectory(prefix="airgs-") as folder, ExitStack() as stack:
        stack.enter_context(patch.object(training, "train_first", begin))
        settings = TrainSettings(max_size=SIDE)
        settings = one.off(settings, stack) if one else settings
        run = training.open_run(rig.seen(), Path(folder) / "model", settings)
        records = list(training.train_frames(run))
        times.append(time.process_time())
        encode(open_sequence(run.model.folder), Path(folder) / "x.airgs", PLAIN)
        size = _top_bytes(open_package(Path(folder) / "x.airgs"))
    assert first
    shown = float(np.mean([record.held_out_matched for record in records]))
    return first, (size, shown, times[2] - times[0]), (size, shown, times[2] - times[1])


def _top_bytes(package: Package) -> float:
    return package.rungs[0].bytes / package.manifest.frames


def summary(rows: Sequence[Row]) -> list[Row]:
    """A row for each mechanism: least and most of what scenes say, and on how many of them it brings enough."""
    found = []
    for name in dict.fromkeys(row["mechanism"] for row in rows):
        some = [row for row in rows if row["mechanism"] == name]
        one: Row = {"mechanism": name, "lines": some[0]["lines"], "enough": sum(map(_earns, some)), "of": len(some)}
        for key in ("bytes", "psnr", "seconds"):
            one |= {f"{key}_least": min(row[key] for row in some), f"{key}_most": max(row[key] for row in some)}
        found.append(one)
    return found


def _earns(row: Row) -> bool:
    return row["bytes"] >= LEAST_BYTES or row["psnr"] <= -LEAST_DB or row["seconds"] >= LEAST_TIME
