"""airgs-encode: Gaussian frames, a file or a folder, or multi-view video, to a package."""

from __future__ import annotations

import json
import os
import stat
import sys
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import field, replace
from fractions import Fraction
from functools import partial
from pathlib import Path

from airgs_codec._settings import required, setting
from airgs_codec.analysis.rows import AUTO
from airgs_codec.analysis.viewpoints import GUESS
from airgs_codec.cli.estimate import of_encode
from airgs_codec.cli.options import (
    AXIS,
    BUCKET,
    CUDA,
    DEVICE,
    FORMS,
    FPS,
    BakingOptions,
    Given,
    WorkOptions,
    as_options,
    expect_report,
    given,
    open_frames,
    run_program,
)
from airgs_codec.cli.terminal import Bar, say, warn
from airgs_codec.cli.train import Train, train_model
from airgs_codec.encoder.decide import decide as make_plan
from airgs_codec.encoder.live import PublishedGroup, follow
from airgs_codec.encoder.order import hold_frames
from airgs_codec.encoder.plan import Plan
from airgs_codec.encoder.publish import PACKAGE_ENDING, EncodeReport
from airgs_codec.encoder.publish import encode as publish
from airgs_codec.encoder.settings import DEFAULT_SETTINGS, EncodeSettings, as_fast, as_in_paper
from airgs_codec.encoder.target import DELTA_E, PSNR, SIZE, Goal
from airgs_codec.errors import ConfigError
from airgs_codec.inspect.summary import format_ladder
from airgs_codec.media.movie import encode_sound
from airgs_codec.package.package import open_package
from airgs_codec.package.region import read_world, world_from
from airgs_codec.package.tables import World
from airgs_codec.places.place import is_address
from airgs_codec.places.whole import expect_folder_name, expect_plain
from airgs_codec.render.backend import open_renderer
from airgs_codec.render.cpu import compile_ahead
from airgs_codec.scene.beside import read_attribution
from airgs_codec.scene.formats.table import without_ending
from airgs_codec.scene.sequence import GaussianSequence, GrowingFolder, open_sequence
from airgs_codec.trainer.data.readers import is_multiview
from airgs_codec.trainer.track import decide as will_track
from airgs_codec.trainer.track import tracked

BY_PRESET: dict[str, Callable[[EncodeSettings], EncodeSettings]]
BY_PRESET = {"default": replace, "fast": as_fast, "paper": as_in_paper}


@as_options
class Encode:
    scene: str = required(
        "frames (a folder or a file: .ply, compressed .ply, .spz, SOG, .splat, glTF), a clip (.splatv, .4dgs, "
        ".splat4d, Spacetime Gaussians .ply), either at s3://, gs://, az:// too, or a folder of multi-view pictures"
    )
    output: str | None = setting(None, f"a folder or {BUCKET}", alias="-o", metavar="PLACE", default="SCENE.airgs")
    preset: str = setting("default", "fast makes no trial encodes, paper has its levels", choices=tuple(BY_PRESET))
    settings: Given = given(EncodeSettings, "encoder", ("quality", "group_frames", "margin"))
    plan: str | bool | None = setting(None, "alone: print what would be chosen, as JSON; with such a file: follow it")
    track: bool | None = setting(None, "fit Gaussians to frames that share no rows", default="where the first do not")
    target_psnr: float | None = setting(None, "search for the quality that gives the top rung this PSNR", metavar="DB")
    target_de: float | None = setting(None, "the same for a mean colour difference CIEDE2000", metavar="ΔE")
    target_mbps: float | None = setting(None, "the same for a bit rate of playback", metavar="MBPS")
    views: Path | None = setting(None, f"cameras to measure with{FORMS}", default="beside the frames, else an orbit")
    fps: Fraction | None = setting(None, "frames a second", default="what the scene says, else 30", **FPS)
    up: tuple[float, ...] | None = setting(None, "up in the frames, x, -y, … or X,Y,Z, else as their format", **AXIS)
    unit: float | None = setting(None, "with --up: metres that a unit of the frames is long", topic="which way is up")
    transform: Path | None = setting(None, "instead: 3x4 or 4x4 numbers, to y up in metres", topic="which way is up")
    follow: bool = setting(False, "encode group by group while frames are still being written")
    idle: float = setting(30.0, "seconds without a frame that end --follow, unless stdin is a pipe", topic="output")
    device: str = setting("auto", f"where video is trained and pictures are drawn{CUDA}", topic="work", **DEVICE)
    audio: Path | None = setting(None, "a file whose sound goes with the frames", topic="output")
    attribution: str | None = setting(None, "who made the scene", topic="output", default="SCENE/ATTRIBUTION.txt")
    report: Path | None = setting(None, "folder for a page that compares the package with the scene", metavar="DIR")
    json: bool = setting(False, "print figures as JSON")
    workers: WorkOptions = field(default_factory=WorkOptions)
    baking: BakingOptions = field(default_factory=BakingOptions)


def encode(options: Encode) -> int:
    """Encode Gaussian frames as H.264 pictures and a DASH manifest; multi-view video is trained first."""
    settings, plan = _settings(options), None
    if isinstance(options.plan, str):
        expect_plain(Path(options.plan))
        plan = Plan.from_json(Path(options.plan).read_bytes(), options.plan)
    _goal(options, 1)  # refuses impossible goals before any work
    expect_report(options.report)
    place = options.scene.rstrip("/") if is_address(options.scene) else Path(options.scene).resolve()
    target = options.output or f"{without_ending(str(place))}{PACKAGE_ENDING}"
    expect_folder_name(target, PACKAGE_ENDING)
    if options.device != "cuda":
        compile_ahead()
    if options.follow:
        return _follow(options, settings, plan, target)
    quiet = options.json or options.plan is True
    sequence = _open(options)
    cameras = sequence.name_of(sequence.cameras_path) if sequence.cameras_path else None
    sound = encode_sound(options.audio, len(sequence) / sequence.fps) if options.audio else None
    _say_what_was_found(options, sequence, sound.note if sound else None, quiet)
    sequence = replace(sequence, credit=options.attribution or sequence.attribution, sound_track=sound)
    sequence, goal = (given := hold_frames(sequence)), _goal(options, float(sequence.fps))
    wanted = False if options.track is None and options.preset == "fast" else options.track
    track, words = will_track(sequence, wanted, settings.rows)
    if words:
        warn(words)
    stored = options.workers.work
    with Bar(options.json) as bar, options.workers.opened(bar) as work, ExitStack() as stack:
        if not (options.json or options.plan is True):
            rows: Given = {"goal": goal is not None, "lost": bool(words), "track": track}
            bar.expect(target, *of_encode(sequence, settings, **rows))
        if track:
            models = Path(stored) if stored and not is_address(stored) else None
            sequence = stack.enter_context(tracked(sequence, open_renderer(options.device), work, models))
        if options.plan is True:
            chosen = make_plan(sequence, settings, goal=goal, progress=bar)
            bar.close()
            say(chosen.to_json())
            return 0
        how: Given = {"goal": goal, "executor": work.executor, "progress": bar}
        done = publish(sequence, target, settings, plan=plan, work=stored, **how)
        if options.report:
            from airgs_codec.inspect.report import write_report  # loads what draws and plays, too

            write_report(options.report, given, open_package(target), done, bar)
    for decision in done.manifest.decisions:
        if decision.startswith(GUESS):
            warn(decision)
    say(json.dumps(_as_json(done, target) | {"cameras": cameras}) if options.json else _as_words(done, target))
    return 0


def _settings(options: Encode) -> EncodeSettings:
    threads, chosen = max(1, DEFAULT_SETTINGS.threads // options.workers.jobs), options.settings
    if options.track and chosen.get("rows", AUTO) != AUTO:
        raise ConfigError(f"--rows: expected {AUTO} with --track, which leaves rows in order, got {chosen['rows']}")
    settings = replace(DEFAULT_SETTINGS, threads=threads, device=options.device, world=_world(options))
    settings = BY_PRESET[options.preset](settings)
    if settings.calibrate == "ladder" and {"levels", "tiers"} & chosen.keys():  # which trial encodes would replace
        chosen = {"calibrate": "steps"} | chosen
    return replace(settings, **chosen)


def _world(options: Encode) -> World | None:
    up, unit = options.up, options.unit
    if options.transform and (up or unit is not None):
        raise ConfigError("--transform: expected neither --up nor --unit with it: it says both")
    if unit is not None and not up:
        raise ConfigError("--unit: expected --up with it")
    return read_world(options.transform) if options.transform else world_from(up, unit) if up else None


def _open(options: Encode) -> GaussianSequence:
    folder = Path(options.scene)
    how: Given = {"views": options.views, "fps": options.fps}
    if is_address(options.scene) or not is_multiview(folder):
        return open_frames(options.scene, quiet=options.json, **how, **vars(options.baking))
    if options.track or any(vars(options.baking).values()):
        raise ConfigError(f"{options.scene}: expected frames for --track, --bake-fps and --duration, got pictures")
    with Bar(options.json) as bar:
        model = train_model(Train(scene=folder, fps=options.fps, device=options.device, resume=True), bar)
    return replace(open_sequence(model.folder, **how), credit=read_attribution(folder))


def _say_what_was_found(options: Encode, sequence: GaussianSequence, sound: str | None, quiet: bool) -> None:
    seen = sequence.cameras
    found = [f"clip: {options.scene}: {sequence.clip.note}"] if sequence.clip else []
    if sequence.cameras_path:
        held_out = sum(camera.held_out for camera in seen)
        found += [f"cameras: {sequence.name_of(sequence.cameras_path)}, {len(seen)} of them, {held_out} held out"]
    found += [f"sound: {options.audio}: {sound}"] if sound else []
    for line in found if not quiet else ():
        say(line)
    for note in sequence.notes:
        warn(note)


def _goal(options: Encode, fps: float) -> Goal | None:
    rate = options.target_mbps
    goals = {
        "--target-psnr": (PSNR, options.target_psnr),
        "--target-de": (DELTA_E, options.target_de),
        "--target-mbps": (SIZE, None if rate is None else 1e3 / 8 * rate / fps),
    }
    asked = [Goal(metric, value) for metric, value in goals.values() if value is not None]
    if len(asked) + ("quality" in options.settings) > 1:
        raise ConfigError(f"expected one of --quality, {', '.join(goals)}")
    return asked[0] if asked else None


def _follow(options: Encode, settings: EncodeSettings, plan: Plan | None, target: str) -> int:
    whole = ("target_psnr", "target_de", "target_mbps", "audio", "report", "track")
    asked = {name: getattr(options, name) for name in whole} | vars(options.baking)
    asked["plan"] = options.plan is True
    given = [f"--{name.replace('_', '-')}" for name, value in asked.items() if value]
    if option := next(iter(given), options.workers.shared_by()):
        raise ConfigError(f"{option}: expected a sequence that is whole, got --follow, whose groups come one by one")
    if is_address(options.scene):
        raise ConfigError(f"--follow: expected a folder of this machine, got {options.scene}")
    folder, number = GrowingFolder(options.scene, views=options.views, fps=options.fps), 0
    more, credit = frames_may_come(options.idle), options.attribution
    with Bar(options.json) as bar:
        for done in follow(folder, target, settings, plan=plan, more=more, attribution=credit, progress=bar):
            number, stop = done.number, done.group.stop
            say(_group_line(done, options.json))
    if number and not options.json:
        say(f"{target}: {stop} frames in {number} groups, closed")
    return 0


def frames_may_come(idle_s: float) -> Callable[[int], bool]:
    """Return a function of the number of frames so far that tells whether more may come.

    Where standard input is a pipe, as behind `airgs-train ... |`, until it ends; its lines are passed on to standard
    error. Else until there is no new frame for `idle_s` seconds.
    """
    if stat.S_ISFIFO(os.fstat(sys.stdin.fileno()).st_mode):
        reader = threading.Thread(target=lambda: [*map(partial(warn, end=""), sys.stdin)], daemon=True)
        reader.start()
        return lambda frames: reader.is_alive()
    seen, since = -1, time.monotonic()

    def more(frames: int) -> bool:
        nonlocal seen, since
        if frames != seen:
            seen, since = frames, time.monotonic()
        return time.monotonic() - since < idle_s

    return more


def _group_line(done: PublishedGroup, as_json: bool) -> str:
    group, (first, last) = done.group, done.waited_s
    size = sum(tier.sidecar.bytes + tier.pictures[0].bytes for tier in group.tiers)
    size += sum(segment.levels[0].file.bytes for segment in group.segments)
    if as_json:
        figures = {"group": done.number, "frames": [group.start, group.stop], "bytes": size, "gaussians": group.count}
        figures |= {"base": group.base, "since_first_frame": round(first, 2), "since_last_frame": round(last, 2)}
        return json.dumps(figures | {"rows": done.notes})
    quality = [level.psnr[0] for segment in group.segments for level in segment.levels[:1] if level.psnr]
    shown = f", {min(quality):.1f} dB at least" if quality else ""
    shown += f", keyframe by its difference to group {group.base}" if group.base else ""
    size_words = f"{size / (group.stop - group.start) / 1e3:.1f} kB/frame on the top rung"
    words = f"group {done.number}: frames {group.start}-{group.stop - 1}, {size_words}{shown}"
    return "\n".join([*done.notes, f"{words}, published {last:.1f} s after its last frame"])


def _as_json(report: EncodeReport, target: str) -> dict[str, object]:
    m, rows = report.manifest, report.rows
    figures: Given = {"package": target, "frames": m.frames, "bytes": m.media_bytes() + report.manifest_bytes}
    figures["top_rung_bytes"] = m.bytes_of(m.rung_files(0, 0)) + report.manifest_bytes
    figures["seconds"] = {stage.about: round(stage.seconds, 3) for stage in report.stages()}
    figures["rows"] = {name: getattr(rows, name) for name in ("matched", "sure", "unmatched", "alone")}
    return figures | {"repairs": [repair for group in m.groups for repair in group.repairs]}


def _as_words(report: EncodeReport, target: str) -> str:
    m, stages = report.manifest, report.stages()
    parts = ", ".join(f"{stage.about} {stage.seconds:.1f}" for stage in stages if stage.seconds >= 0.05)
    megabytes = (m.media_bytes() + report.manifest_bytes) / 1e6
    seconds = "" if m.still else f" {float(m.frames / m.fps):.2f} s,"
    size = f"{m.length},{seconds} {megabytes:.2f} MB with all rungs"
    took = f"{sum(stage.seconds for stage in stages):.0f} s ({parts})"
    next_steps = f"play it: airgs-serve {target}; all tables: airgs-manifest inspect {target}"
    return f"{format_ladder(m, report.manifest_bytes)}\n\n{target}: {size}; {took}\n{next_steps}"


main = partial(run_program, "airgs-encode", encode)
