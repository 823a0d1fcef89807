"""airgs-train: multi-view video, or frames that share no rows, to Gaussians that move."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import asdict, dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any

from airgs_codec._settings import required, setting
from airgs_codec.cli.options import (
    CUDA,
    DEVICES,
    FRAMES,
    RATE,
    Given,
    WorkOptions,
    expect_report,
    given,
    open_frames,
    parse_frames,
    run_program,
    takes,
)
from airgs_codec.cli.terminal import Bar, say, warn
from airgs_codec.errors import ConfigError
from airgs_codec.scene.camera import BLACK
from airgs_codec.scene.sequence import GaussianSequence
from airgs_codec.trainer import default_settings, model_folder, require_torch
from airgs_codec.trainer.data.multiview import MultiviewScene, frames_of, with_held_out, with_near
from airgs_codec.trainer.data.readers import has_gaussians, open_scene, shortened
from airgs_codec.trainer.settings import AUTO, FIRST, FIRST_A_VIEW, OFF, TRAIN_PRESETS, TrainSettings, preset
from airgs_codec.trainer.track import decide, pictured, track_settings

if TYPE_CHECKING:  # torch is imported when training begins
    from airgs_codec.jobs.work import Work
    from airgs_codec.trainer.pipeline import TrainingRun
    from airgs_codec.trainer.record import FrameRecord, ModelFolder

DEFAULTS = TrainSettings()
FIT_ITERATIONS = ("first_iterations", "keyframe_iterations", "frame_iterations")
EFFORTS = {"quick": 0.4, "normal": 1.0, "high": 2.5}
MATCHED_DB = 0.2  # that held-out views gain by matching their exposure, from which a frame says so
PAGE_SHARE = 10  # times as long as it takes to write a page is trained before the next one
EVERYDAY = ("max_size", "background", "budget", "max_drop_db", "group_frames")


@dataclass(frozen=True, kw_only=True)
class Train(WorkOptions):
    scene: Path = required(
        "folder with transforms.json, train_meta.json (Panoptic), image_white_undistortion/ (HiFi4G), COLMAP's sparse/ "
        "or poses_bounds.npy, and pictures or a video of each camera; or frames of Gaussians that share no rows"
    )
    output: Path | None = setting(None, "model folder", alias="-o", metavar="DIR", default="SCENE.gaussians")
    resume: bool = setting(False, "go on with the run in the model folder")
    preset: str = setting(
        TRAIN_PRESETS[0],
        "settings to begin with: paper has the AirGS paper's method and constants, read literally",
        choices=TRAIN_PRESETS,
    )
    frames: str = setting(":", FRAMES, metavar="A:B", default="all")
    fps: Fraction | None = setting(None, "frames a second", default="what the scene says, else 30", **RATE)
    hold_out: str | None = setting(
        None,
        "cameras held out for testing, with commas, or none",
        metavar="NAMES",
        default="the scene's, else one in eight",
    )
    effort: str = setting(
        "normal",
        "iterations of every frame: quick has two fifths of the normal ones, high two and a half times as many",
        choices=tuple(EFFORTS),
    )
    iterations: str | None = setting(
        None,
        "iterations of a first frame, a keyframe and any other frame "
        f"(default: {FIRST},{DEFAULTS.keyframe_iterations},{DEFAULTS.frame_iterations}); "
        f"of a first frame at least {FIRST_A_VIEW} for each view",
        metavar="FIRST,KEY,FRAME",
    )
    settings: Given = given(TrainSettings, "method", EVERYDAY)
    near: float | None = setting(
        None,
        "hide Gaussians nearer to a camera than this many world units (default: the scene's, else 0.01)",
        metavar="UNITS",
        topic="scene",
    )
    sync: str = setting(
        AUTO,
        "whether cameras that are not in step are matched, by what moves: auto, off, or a JSON file with an object of "
        "cameras and by how many frames each is late (negative: early)",
        metavar="auto|off|FILE",
        topic="scene",
    )
    device: str = setting("auto", f"where it runs{CUDA}", choices=DEVICES)
    report: Path | None = setting(None, "folder for a page with curves, pictures and error maps", metavar="DIR")
    json: bool = setting(False, "print the record as JSON instead of a line a frame")


def main(argv: Sequence[str] | None = None) -> int:
    return run_program("airgs-train", train, argv)


@takes(Train)
def train(options: Train) -> int:
    """Train Gaussians that move, from multi-view video or frames that share no rows, for airgs-encode."""
    require_torch()
    expect_report(options.report)
    folder = model_folder(options.scene, options.output)
    _settings(options, default_settings("cpu"))  # what cannot work is refused before torch is loaded, which takes long
    opened = _frames(options) if has_gaussians(options.scene) else _scene(options)

    from airgs_codec.render.backend import open_renderer
    from airgs_codec.trainer.fit.points import SPARSE_DEGREES, degrees_apart
    from airgs_codec.trainer.pipeline import open_run
    from airgs_codec.trainer.report import write_report

    elsewhere = options.executor and options.device == "cuda"  # the workers have it
    renderer = open_renderer("auto" if elsewhere else options.device)
    device = "cuda" if elsewhere else renderer.device
    shared = options.shared_by()
    if isinstance(opened, GaussianSequence):
        settings, scene = _settings(options, track_settings(opened)), pictured(opened, renderer)
    else:
        settings = _settings(options, default_settings(device), sum(not c.held_out for c in opened.cameras))
        if settings.group_frames is None and shared:
            words = "expected --group-frames, without which no frame is fitted before the last one"
            raise ConfigError(f"{shared}: {words}")
        scene = _in_step(options, opened, settings, folder)
    run = open_run(scene, folder, settings, resume=options.resume, device=device)
    cameras = [] if scene.given else [camera for camera in scene.cameras if not camera.held_out]
    if cameras and (apart := degrees_apart(cameras)) > SPARSE_DEGREES and not options.json:
        say(f"{options.scene}: {len(cameras)} training cameras {apart:.0f}° apart: views between them will be soft")

    def page() -> None:
        exposed = run.capture.pictures.with_exposure(run.model.record.exposure)
        if options.report:
            write_report(run.model, exposed, options.report, renderer)

    often = page if options.report and not shared else None
    needs: dict[str, float] | None = {"GPU": 1} if device == "cuda" else None
    with Bar(options.json) as bar, options.opened(bar, needs) if shared else nullcontext() as work:
        model = train_run(run, bar, quiet=options.json, work=work, page=often)
    page()
    say(json.dumps(summary(model)) if options.json else as_words(model, options.report))
    return 0


def _frames(options: Train) -> GaussianSequence:
    """The frames that are tracked; what that costs is said. Raises ConfigError for options of pictures."""
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
    scene = open_scene(options.scene, fps=options.fps)
    frames_of(scene, parse_frames(options.frames))  # those that are not there are told before anything is read
    scene = with_held_out(scene, [] if hold_out == "none" else hold_out.split(",") if hold_out is not None else None)
    return scene if near is None else with_near(scene, near)


def _in_step(options: Train, scene: MultiviewScene, settings: TrainSettings, folder: Path) -> MultiviewScene:
    from airgs_codec.trainer.record import known_offsets

    if settings.background is None and scene.background != BLACK and not options.json:
        colour = ",".join(f"{c:g}" for c in scene.background)
        say(f"{options.scene}: its pictures are before a background of {colour}")
    known = known_offsets(folder) if options.resume else None
    return match_cameras(scene, parse_frames(options.frames), options.sync, known, quiet=options.json)


def match_cameras(
    scene: MultiviewScene, span: tuple[int, int | None], sync: str, known: Mapping[str, float] | None, *, quiet: bool
) -> MultiviewScene:
    """The frames [A, B) of a scene with its cameras in step, as --sync says; what was found is said.

    `known`: what the run that goes on has found; None: it is a new one. Raises SceneError.
    """
    from airgs_codec.trainer.data.sync import find_offsets, in_step, read_offsets  # what they import takes a second

    for note in () if quiet else scene.notes:
        say(f"{scene.path}: {note}")
    if sync not in (AUTO, OFF):
        return in_step(scene, read_offsets(Path(sync)), span)
    if known is not None:
        return in_step(scene, known if sync == AUTO else {}, span)
    with Bar(quiet) as bar:
        found = find_offsets(scene, span, bar) if sync == AUTO else {}
    matched = in_step(scene, found, span)
    if found and not quiet:
        order = sorted(found, key=lambda name: -abs(found[name]))
        words = [f"{name} is {abs(found[name]):g} frames {'late' if found[name] > 0 else 'early'}" for name in order]
        left = f"all have {len(matched)} of {len(range(*frames_of(scene, span)))} frames"
        say(f"{shortened(words)}: matched, {left}; --sync off leaves it")
    return matched


def _settings(options: Train, usual: TrainSettings, views: int = 1) -> TrainSettings:
    """The settings of a scene with so many training views. Raises ConfigError for options that cannot work."""
    base, names = preset(options.preset, usual), FIT_ITERATIONS
    counts: dict[str, int] = {}
    if (factor := EFFORTS[options.effort]) != 1:
        known = (base.iterations_from_scratch(views), base.keyframe_iterations, base.frame_iterations)
        counts = {name: round(factor * count) for name, count in zip(names, known, strict=True)}
    if options.iterations is not None:
        try:
            counts = dict(zip(names, map(int, options.iterations.split(",")), strict=True))
        except ValueError as error:
            raise ConfigError(f"--iterations: expected FIRST,KEY,FRAME, got {options.iterations!r}") from error
    return replace(base, **(counts | dict(options.settings)))


def summary(model: ModelFolder) -> dict[str, Any]:
    """The record as JSON has it, and what it comes to: means over frames; PSNR as `psnr_definition` says."""
    from airgs_codec.trainer.fit.losses import PSNR_DEFINITION

    frames = model.record.frames
    seen = [(f.held_out_psnr, f.held_out_matched or 0.0) for f in frames if f.held_out_psnr is not None]
    held_out, matched = zip(*seen, strict=True) if seen else ((), ())
    return {
        "model": str(model.folder),
        "frames": [asdict(f) for f in frames],
        "keyframes": model.record.keyframes(),
        "psnr_definition": PSNR_DEFINITION,
        "psnr": sum(f.psnr for f in frames) / len(frames),
        "held_out_psnr": sum(held_out) / len(held_out) if held_out else None,
        "held_out_matched": sum(matched) / len(matched) if matched else None,
        "held_out_worst": min(held_out) if held_out else None,
        "seconds": sum(f.seconds for f in frames),
        "warnings": model.record.warnings(),
    }


def as_words(model: ModelFolder, report: Path | None) -> str:
    s, held_out = summary(model), ""
    if s["held_out_psnr"] is not None:
        held_out = f", held-out {s['held_out_psnr']:.2f} (worst {s['held_out_worst']:.2f})"
        if s["held_out_matched"] - s["held_out_psnr"] >= MATCHED_DB:
            held_out += f", {s['held_out_matched']:.2f} with exposure matched"
    page = f"\nreport: {report / 'index.html'}" if report else ""
    counts = f"{len(s['frames'])} frames, {len(s['keyframes'])} groups"
    quality = f"{s['psnr']:.2f} dB (mean over views and frames){held_out}"
    return f"{model.folder}: {counts}, {quality}, {s['seconds']:.0f} s{page}"


def train_by_default(scene: Path, fps: Fraction | None, device: str, *, quiet: bool) -> Path:
    """The model folder of a multi-view scene, trained as far as it is not yet, with default settings."""
    require_torch()
    from airgs_codec.render.backend import open_renderer
    from airgs_codec.trainer.pipeline import open_run
    from airgs_codec.trainer.record import known_offsets

    views, folder = with_held_out(open_scene(scene, fps=fps), None), model_folder(scene)
    device = open_renderer(device).device
    views = match_cameras(views, (0, None), AUTO, known_offsets(folder), quiet=quiet)
    run = open_run(views, folder, default_settings(device), resume=True, device=device)
    with Bar(quiet) as bar:
        return train_run(run, bar, quiet=quiet).folder


def train_run(
    run: TrainingRun, bar: Bar, *, quiet: bool, work: Work | None = None, page: Callable[[], None] | None = None
) -> ModelFolder:
    """Train, here or by `work`, and say what is done; `page` writes a page of the run so far, now and then."""
    from airgs_codec.trainer.pipeline import train_frames, train_in_jobs

    records = train_in_jobs(run, work) if work else train_frames(run, bar)
    if not (quiet or work or run.model.finished()):
        seen, left = run.capture.pictures.cameras(), run.model.record.total - len(run.model.record.frames)
        held_out = sum(camera.held_out for camera in seen)
        cameras = f"{len(seen) - held_out} training cameras and {held_out} held out"
        say(f"{run.capture.scene.path}: {left} frames of {seen[0].width}x{seen[0].height}, {cameras}")
    said, due_s = set[str](), 0.0
    for record in records:
        bar.close()
        if not quiet:
            say(frame_line(record))
            if record.kind == "first" and run.model.record.exposure:
                say(exposure_line(run.model.record.exposure))
        for warning in set(run.model.record.warnings()) - said:
            warn(f"warning: {warning}")
            said.add(warning)
        if page and (begun_s := time.monotonic()) >= due_s and not run.model.record.complete:
            page()
            due_s = time.monotonic() + PAGE_SHARE * (time.monotonic() - begun_s)
    return run.model


def exposure_line(exposure: Mapping[str, Sequence[float]]) -> str:
    gains = {name: sum(values[:3]) / 3 for name, values in exposure.items()}
    dark, bright = min(gains, key=gains.__getitem__), max(gains, key=gains.__getitem__)
    ends = f"{dark} has {100 * gains[dark]:.0f} % of the average and {bright} {100 * gains[bright]:.0f}"
    return f"exposure differs, {ends}: matched; --match-exposure off leaves it"


def frame_line(r: FrameRecord) -> str:
    held_out = "" if r.held_out_psnr is None else f", held-out {r.held_out_psnr:.2f}"
    if r.held_out_psnr and r.held_out_matched and r.held_out_matched - r.held_out_psnr >= MATCHED_DB:
        held_out += f" ({r.held_out_matched:.2f} with exposure matched)"
    kind = {"first": "  first frame", "frame": "", "keyframe": f"  keyframe, {r.added:+,} Gaussians"}[r.kind]
    if r.cleared:
        kind += f"  ({r.cleared:,} removed that hung before viewers)"
    if r.rejected_psnr is not None:
        other = "as a keyframe" if r.kind == "frame" else "in the old group"
        kind += f"  ({other} {r.rejected_psnr:.2f} dB)"
    return f"frame {r.frame:4d}  {r.psnr:.2f} dB{held_out}  {r.gaussians:,} Gaussians  {r.seconds:.1f} s{kind}"
