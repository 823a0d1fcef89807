"""airgs-train: multi-view video, or frames that share no rows, to Gaussians that move."""

from __future__ import annotations

import json
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, field, replace
from fractions import Fraction
from functools import partial
from pathlib import Path
from statistics import fmean
from typing import TYPE_CHECKING, Any

from airgs_codec._settings import required, setting
from airgs_codec.cli.estimate import of_training
from airgs_codec.cli.options import (
    CUDA,
    DEVICE,
    FPS,
    FRAMES_HELP,
    Given,
    WorkOptions,
    as_options,
    expect_report,
    given,
    open_frames,
    parse_frames,
    read_three,
    run_program,
)
from airgs_codec.cli.terminal import Bar, say, warn
from airgs_codec.errors import ConfigError
from airgs_codec.scene.sequence import GaussianSequence
from airgs_codec.trainer import default_settings, model_folder, require_torch
from airgs_codec.trainer.data.multiview import MultiviewScene, frames_of, with_held_out, with_near
from airgs_codec.trainer.data.readers import has_gaussians, open_scene, shortened
from airgs_codec.trainer.settings import AUTO, FIRST, FIRST_A_VIEW, OFF, TRAIN_PRESETS, TrainSettings, preset
from airgs_codec.trainer.track import decide, pictured, track_settings

if TYPE_CHECKING:  # torch is imported when training begins
    from airgs_codec.trainer.record import FrameRecord, ModelFolder

DEFAULTS = TrainSettings()
FIT_ITERATIONS = ("first_iterations", "keyframe_iterations", "frame_iterations")
EFFORTS = {"quick": 0.4, "normal": 1.0, "high": 2.5}
EFFORT_WORDS = ", ".join(f"{factor:g} ({name})" for name, factor in EFFORTS.items())
COUNTS, SYNC = "FIRST,KEY,FRAME", "auto|off|FILE"
SCENE: Given = {"topic": "scene"}
ITERATIONS_HELP = f"of a first frame, by default at least {FIRST_A_VIEW} a view, a keyframe and any other frame"
USUAL_ITERATIONS = f"{FIRST},{DEFAULTS.keyframe_iterations},{DEFAULTS.frame_iterations}"
ITERATIONS: Given = {"default": USUAL_ITERATIONS, "metavar": COUNTS, "read": read_three(int, COUNTS)}
EVERYDAY = ("max_size", "background", "budget", "max_drop_db", "group_frames")
NOTED_DB = 0.2  # that held-out views gain by matching their exposure, from which a frame says so
PAGE_SHARE = 10  # times as long as it takes to write a page is trained before the next one


@as_options
class Train:
    scene: Path = required(
        "folder with transforms.json, train_meta.json (Panoptic), image_white_undistortion/ (HiFi4G), COLMAP's sparse/ "
        "or poses_bounds.npy, and pictures or a video of each camera; or frames of Gaussians that share no rows"
    )
    output: Path | None = setting(None, "model folder", alias="-o", metavar="DIR", default="SCENE.gaussians")
    resume: bool = setting(False, "go on with the run in the model folder")
    preset: str = setting(TRAIN_PRESETS[0], "paper: the AirGS paper's method and constants", choices=TRAIN_PRESETS)
    frames: str = setting(":", FRAMES_HELP, metavar="A:B", default="all")
    fps: Fraction | None = setting(None, "frames a second", default="what the scene says, else 30", **FPS)
    hold_out: str | None = setting(None, "test cameras, or none", metavar="NAMES", default="the scene's, or one in 8")
    effort: str = setting("normal", f"iterations of every frame, times {EFFORT_WORDS}", choices=tuple(EFFORTS))
    iterations: tuple[int, ...] | None = setting(None, ITERATIONS_HELP, **ITERATIONS)
    settings: Given = given(TrainSettings, "method", EVERYDAY)
    near: float | None = setting(None, "hide what is nearer, in world units", default="the scene's, else 0.01", **SCENE)
    sync: str = setting(AUTO, "match cameras by what moves, or JSON of frames each is late", metavar=SYNC, **SCENE)
    device: str = setting("auto", f"where it runs{CUDA}", **DEVICE)
    report: Path | None = setting(None, "folder for a page with curves, pictures and error maps", metavar="DIR")
    json: bool = setting(False, "print the record as JSON instead of a line a frame")
    workers: WorkOptions = field(default_factory=WorkOptions)


def train(options: Train) -> int:
    """Train Gaussians that move, from multi-view video or frames that share no rows, for airgs-encode."""
    with Bar(options.json) as bar:
        model = train_model(options, bar)
    say(json.dumps(summary(model)) if options.json else _as_words(model, options.report))
    return 0


def train_model(options: Train, bar: Bar) -> ModelFolder:
    """Return the model that the options ask for; unless the bar is quiet, say what was found and a line a frame."""
    require_torch()
    expect_report(options.report)
    folder = model_folder(options.scene, options.output)
    _settings(options, default_settings("cpu"))  # refuses what cannot work before torch is loaded, which takes long
    opened = _frames(options) if has_gaussians(options.scene) else _scene(options)

    from airgs_codec.render.backend import open_renderer
    from airgs_codec.trainer.pipeline import open_run, train_frames, train_in_jobs
    from airgs_codec.trainer.record import known_offsets
    from airgs_codec.trainer.report import write_report

    shared = options.workers.shared_by()
    elsewhere = options.workers.executor and options.device == "cuda"  # the workers have it
    renderer = open_renderer("auto" if elsewhere else options.device)
    device = "cuda" if elsewhere else renderer.device
    known = known_offsets(folder) if options.resume else None
    if isinstance(opened, GaussianSequence):
        settings, span = _settings(options, track_settings(opened)), (0, len(opened))
    else:
        settings = _settings(options, default_settings(device), sum(not c.held_out for c in opened.cameras))
        if settings.group_frames is None and shared:
            raise ConfigError(f"{shared}: expected --group-frames, without which each frame follows the one before")
        span = frames_of(opened, parse_frames(options.frames))
    if known is None:
        bar.expect(str(folder), *of_training(opened, len(range(*span)), settings, device))
    if isinstance(opened, GaussianSequence):
        scene = pictured(opened, renderer, bar)
    else:
        scene = match_cameras(opened, span, options.sync, known, bar)
    run = open_run(scene, folder, settings, resume=options.resume, device=device)
    record, due_s, said = run.model.record, 0.0, set[str]()
    if not (bar.quiet or shared or run.model.finished()):
        seen, left = run.capture.pictures.cameras(), record.total - len(record.frames)
        held_out = sum(camera.held_out for camera in seen)
        cameras = f"{len(seen) - held_out} training cameras and {held_out} held out"
        bar.close()
        say(f"{scene.path}: {left} frames of {seen[0].width}x{seen[0].height}, {cameras}")

    def page() -> None:
        exposed = run.capture.pictures.with_exposure(run.model.record.exposure)
        if options.report:
            write_report(run.model, exposed, options.report, renderer)

    with options.workers.opened(bar, {"GPU": 1} if device == "cuda" else None) as work:
        for frame in train_in_jobs(run, work) if work.elsewhere else train_frames(run, work.progress):
            record, begun_s = run.model.record, time.monotonic()
            bar.close()
            if not bar.quiet:
                say(_frame_line(frame, record.exposure))
            for warning in set(record.warnings()) - said:
                warn(f"warning: {warning}")
                said.add(warning)
            if begun_s >= due_s and not (shared or record.complete):
                page()
                due_s = time.monotonic() + PAGE_SHARE * (time.monotonic() - begun_s)
    page()
    return run.model


def _frames(options: Train) -> GaussianSequence:
    usual = {"hold_out": None, "near": None, "sync": AUTO, "frames": ":"}
    if option := next((name for name, value in usual.items() if getattr(options, name) != value), None):
        raise ConfigError(f"--{option.replace('_', '-')}: expected multi-view pictures, got frames of Gaussians")
    sequence = open_frames(str(options.scene), quiet=options.json, fps=options.fps)
    warn(decide(sequence, wanted=True)[1])
    return sequence


def _scene(options: Train) -> MultiviewScene:
    near, hold_out = options.near, options.hold_out
    if near is not None and not 0 < near < float("inf"):
        raise ConfigError(f"--near: expected a positive distance, got {near}")
    names = None if hold_out is None else [] if hold_out == "none" else hold_out.split(",")
    scene = with_held_out(open_scene(options.scene, fps=options.fps), names)
    frames_of(scene, parse_frames(options.frames))  # refuses missing frames before anything is read
    return scene if near is None else with_near(scene, near)


def match_cameras(
    scene: MultiviewScene, span: tuple[int, int | None], sync: str, known: Mapping[str, float] | None, bar: Bar
) -> MultiviewScene:
    """Return the frames [A, B) of a scene with its cameras in step, as --sync says; what was found is said.

    `known`: offsets in the record of a run that is resumed; None: a new run. Raises SceneError.
    """
    from airgs_codec.trainer.data.sync import find_offsets, in_step, read_offsets  # what they import takes a second

    for note in () if bar.quiet else scene.notes:
        say(f"{scene.path}: {note}")
    if sync != AUTO or known is not None:
        return in_step(scene, {} if sync == OFF else read_offsets(Path(sync)) if sync != AUTO else known or {}, span)
    found = find_offsets(scene, span, bar)
    bar.close()
    matched = in_step(scene, found, span)
    if found and not bar.quiet:
        order = sorted(found, key=lambda name: -abs(found[name]))
        words = [f"{name} is {abs(found[name]):g} frames {'late' if found[name] > 0 else 'early'}" for name in order]
        left = f"all have {len(matched)} of {len(range(*frames_of(scene, span)))} frames"
        say(f"{shortened(words)}: matched, {left}; --sync off leaves it")
    return matched


def _settings(options: Train, usual: TrainSettings, views: int = 1) -> TrainSettings:
    base, factor = preset(options.preset, usual), EFFORTS[options.effort]
    counts = options.iterations
    if counts is None and factor != 1:
        usual_counts = (base.iterations_from_scratch(views), base.keyframe_iterations, base.frame_iterations)
        counts = tuple(round(factor * count) for count in usual_counts)
    given: Given = dict(zip(FIT_ITERATIONS, counts or (), strict=False)) | options.settings
    return replace(base, **given)


def summary(model: ModelFolder) -> dict[str, Any]:
    """Return the record as JSON has it, and means over its frames; PSNR as `psnr_definition` says."""
    from airgs_codec.trainer.fit.losses import PSNR_DEFINITION

    frames = model.record.frames
    held_out = [f.held_out_psnr for f in frames if f.held_out_psnr is not None]
    s: Given = {"model": str(model.folder), "frames": [asdict(f) for f in frames]}
    s |= {"keyframes": model.record.keyframes(), "psnr_definition": PSNR_DEFINITION}
    s["psnr"] = fmean(f.psnr for f in frames)
    s |= {"held_out_psnr": fmean(held_out) if held_out else None, "held_out_lowest": min(held_out, default=None)}
    return s | {"seconds": sum(f.seconds for f in frames), "warnings": model.record.warnings()}


def _as_words(model: ModelFolder, report: Path | None) -> str:
    s = summary(model)
    held_out = ", held-out {held_out_psnr:.2f} (lowest {held_out_lowest:.2f})".format(**s) if s["held_out_psnr"] else ""
    counts = f"{len(s['frames'])} frames, {len(s['keyframes'])} groups"
    page = f"\nreport: {report / 'index.html'}" if report else ""
    quality = f"{s['psnr']:.2f} dB (mean over views and frames){held_out}"
    return f"{model.folder}: {counts}, {quality}, {s['seconds']:.0f} s{page}"


def _frame_line(r: FrameRecord, exposure: Mapping[str, Sequence[float]]) -> str:
    held_out = "" if r.held_out_psnr is None else f", held-out {r.held_out_psnr:.2f}"
    if r.held_out_psnr and r.held_out_matched and r.held_out_matched - r.held_out_psnr >= NOTED_DB:
        held_out += f" ({r.held_out_matched:.2f} with exposure matched)"
    kind = {"first": "  first frame", "frame": "", "keyframe": f"  keyframe, {r.added:+,} Gaussians"}[r.kind]
    if r.kind == "first" and exposure:
        gains = [100 * fmean(values[:3]) for values in exposure.values()]
        kind += f"  (exposure differs, {min(gains):.0f} to {max(gains):.0f} % of the average: matched)"
    if r.cleared:
        kind += f"  ({r.cleared:,} removed that hung before viewers)"
    if r.rejected_psnr is not None:
        kind += f"  ({'as a keyframe' if r.kind == 'frame' else 'in the old group'} {r.rejected_psnr:.2f} dB)"
    return f"frame {r.frame:4d}  {r.psnr:.2f} dB{held_out}  {r.gaussians:,} Gaussians  {r.seconds:.1f} s{kind}"


main = partial(run_program, "airgs-train", train)
