"""airgs-encode: Gaussian frames, a file or a folder, or multi-view video, to a package."""

from __future__ import annotations

import json
import shutil
import sys
import tempfile
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path

from airgs_codec._settings import required, setting
from airgs_codec.analysis.rows import AUTO
from airgs_codec.analysis.viewpoints import GUESS
from airgs_codec.cli.follow import frames_may_come, report_groups
from airgs_codec.cli.options import (
    AXIS,
    BUCKET,
    CUDA,
    DEVICES,
    FORMS,
    RATE,
    BakingOptions,
    Given,
    WorkOptions,
    expect_one,
    expect_report,
    given,
    open_frames,
    option_name,
    run_program,
    takes,
)
from airgs_codec.cli.terminal import Bar, say, warn
from airgs_codec.cli.train import train_by_default
from airgs_codec.encoder.decide import decide as make_plan
from airgs_codec.encoder.live import follow
from airgs_codec.encoder.order import hold_frames
from airgs_codec.encoder.plan import Plan
from airgs_codec.encoder.publish import ENDING, EncodeReport
from airgs_codec.encoder.publish import encode as publish
from airgs_codec.encoder.settings import DEFAULT_SETTINGS, EncodeSettings, as_in_paper, as_preview
from airgs_codec.encoder.target import DELTA_E, PSNR, SIZE, Goal
from airgs_codec.errors import ConfigError
from airgs_codec.inspect.report import write_report
from airgs_codec.inspect.summary import format_ladder
from airgs_codec.media.movie import encode_sound
from airgs_codec.package.package import open_package
from airgs_codec.package.region import read_world, world_from
from airgs_codec.package.tables import World
from airgs_codec.places.place import is_address
from airgs_codec.places.whole import expect_folder_name, expect_plain
from airgs_codec.render import cpu_kernels
from airgs_codec.render.backend import open_renderer
from airgs_codec.scene.beside import read_attribution
from airgs_codec.scene.sequence import GaussianSequence, GrowingFolder, open_sequence
from airgs_codec.trainer.data.readers import is_multiview
from airgs_codec.trainer.track import decide as will_track
from airgs_codec.trainer.track import tracked

PRESETS: dict[str, Callable[[EncodeSettings], EncodeSettings]] = {
    "default": replace,
    "quick": as_preview,
    "paper": as_in_paper,
}
PRINTED = "-"  # in place of a file: the plan is printed
EVERYDAY = ("quality", "group_frames", "margin")  # of the settings of the encoder


@dataclass(frozen=True, kw_only=True)
class Encode(BakingOptions, WorkOptions):
    scene: str = required(
        "frames (a folder or a file: .ply, compressed .ply, .spz, SOG, .splat, glTF), a clip (.splatv, .4dgs, "
        ".splat4d, Spacetime Gaussians .ply), either at s3://, gs://, az:// too, or a folder of "
        "multi-view pictures"
    )
    output: str | None = setting(
        None, f"package: a folder or {BUCKET}", alias="-o", metavar="PLACE", default="SCENE.airgs"
    )
    preset: str = setting(
        "default",
        "settings to begin with: quick is a first look; it makes no trial encodes; paper has eleven levels pruned by "
        "usage alone, equal steps, one keyframe",
        choices=tuple(PRESETS),
    )
    settings: Given = given(EncodeSettings, "encoder", EVERYDAY)
    plan: str | None = setting(
        None,
        "alone: print what would be chosen, as JSON, and encode nothing; with a file of that: follow it",
        topic="encoder",
    )
    track: bool | None = setting(
        None,
        "frames that share no rows become Gaussians that move, fitted to pictures of the frames; seconds a frame, and "
        "then far fewer bytes",
        default="where the first frames share none",
    )
    target_psnr: float | None = setting(
        None, "search for the quality at which the top rung has so many dB", metavar="DB"
    )
    target_de: float | None = setting(None, "the same for a mean colour difference CIEDE2000", metavar="ΔE")
    target_kb: float | None = setting(None, "the same for so many kilobytes a frame on the top rung", metavar="KB")
    target_mbps: float | None = setting(None, "the same for so many megabits a second of playback", metavar="MBPS")
    views: Path | None = setting(None, f"cameras to measure with{FORMS}", default="beside the frames, else an orbit")
    fps: Fraction | None = setting(None, "frames a second", default="what the scene says, else 30", **RATE)
    up: tuple[float, ...] | None = setting(
        None, "direction that points up in the frames, x, -y, … or X,Y,Z; by default as their format has it", **AXIS
    )
    unit: float | None = setting(None, "with --up: metres that a unit of the frames is long", topic="which way is up")
    transform: Path | None = setting(
        None,
        "instead of these: 3x4 or 4x4 numbers row by row, text or JSON, from the frames to a world with y up in "
        "metres: a turn, one scale, a shift",
        topic="which way is up",
    )
    follow: bool = setting(False, "encode group by group while frames are still being written")
    idle: float = setting(
        30.0, "with --follow, unless standard input is a pipe: seconds without a frame that end it", topic="output"
    )
    device: str = setting("auto", f"where video is trained and pictures are drawn{CUDA}", choices=DEVICES, topic="work")
    audio: Path | None = setting(None, "a file whose sound goes with the frames", topic="output")
    attribution: str | None = setting(None, "who made the scene", topic="output", default="SCENE/ATTRIBUTION.txt")
    report: Path | None = setting(None, "folder for a page with what came out beside what was given", metavar="DIR")
    json: bool = setting(False, "print figures as JSON")


def main(argv: Sequence[str] | None = None) -> int:
    told = list(sys.argv[1:] if argv is None else argv)
    for place, word in enumerate(told):
        if word == "--plan" and (place + 1 == len(told) or told[place + 1].startswith("-")):
            told[place] = f"--plan={PRINTED}"
    return run_program("airgs-encode", encode, told)


@takes(Encode)
def encode(options: Encode) -> int:
    """Encode Gaussian frames as H.264 pictures and a DASH manifest; multi-view video is trained first."""
    settings = _settings(options)
    expect_report(options.report)
    target = options.output or _default_target(options.scene)
    expect_folder_name(target, ENDING)
    plan = _plan(options)
    if options.follow:
        return _follow(options, settings, plan, target)
    sequence = _open(options)
    quiet = options.json or options.plan == PRINTED
    if sequence.clip and not quiet:
        say(f"clip: {options.scene}: {sequence.clip.note}")
    goal = _goal(options, sequence)
    cameras = sequence.name_of(sequence.cameras_path) if sequence.cameras_path else None
    if cameras and not quiet:
        held_out = sum(camera.held_out for camera in sequence.cameras)
        say(f"cameras: {cameras}, {len(sequence.cameras)} of them, {held_out} held out")
    for note in sequence.notes:
        warn(note)
    sound = encode_sound(options.audio, len(sequence) / sequence.fps) if options.audio else None
    if sound and sound.note and not quiet:
        say(f"sound: {options.audio}: {sound.note}")
    sequence = replace(sequence, credit=options.attribution or sequence.attribution, sound_track=sound)
    frames = min(settings.group_frames, len(sequence))
    waiting = 2 * options.jobs * frames * max(header.bytes for header in sequence.headers)  # deltas of groups
    if (free := shutil.disk_usage(tempfile.gettempdir()).free) < waiting:
        raise ConfigError(f"{tempfile.gettempdir()}: expected {waiting / 1e9:.1f} GB of room, got {free / 1e9:.1f} GB")
    if options.track and settings.rows != AUTO:
        raise ConfigError(f"--rows: expected {AUTO} with --track, which leaves rows in order, got {settings.rows}")
    sequence = hold_frames(sequence)
    wanted = False if options.track is None and options.preset == "quick" else options.track
    track, line = will_track(sequence, wanted, settings.rows)
    if line:
        warn(line)
    folder = cpu_kernels.blend.stats.cache_path  # None where numba cannot write one
    if folder and not any(Path(folder).glob("cpu_kernels.blend-*.nbi")):
        warn("compiling kernels, once (about half a minute)")
    with ExitStack() as stack:
        bar = stack.enter_context(Bar(options.json))
        work = stack.enter_context(options.opened(bar))
        if track:
            models = Path(options.work) if options.work and not is_address(options.work) else None
            sequence = stack.enter_context(tracked(sequence, open_renderer(options.device), work, models))
        if options.plan == PRINTED:
            chosen = make_plan(sequence, settings, goal=goal, progress=bar)
            bar.close()
            say(chosen.to_json())
            return 0
        done = publish(
            sequence, target, settings, goal=goal, plan=plan, executor=work.executor, work=options.work, progress=bar
        )
        if options.report:
            write_report(options.report, sequence, open_package(target), done, bar)
    for line in done.manifest.decisions:
        if line.startswith(GUESS):
            warn(line)
    say(json.dumps(_as_json(done, target) | {"cameras": cameras}) if options.json else _as_words(done, target))
    return 0


def _settings(options: Encode) -> EncodeSettings:
    """Raises ConfigError for options that cannot work."""
    told = options.settings
    expect_one(
        quality=told.get("quality"),
        target_psnr=options.target_psnr,
        target_de=options.target_de,
        target_kb=options.target_kb,
        target_mbps=options.target_mbps,
    )
    expect_one(margin=told.get("margin"), region=told.get("region"))
    threads = max(1, DEFAULT_SETTINGS.threads // max(1, options.jobs))
    settings = replace(DEFAULT_SETTINGS, threads=threads, device=options.device, world=_world(options))
    settings = PRESETS[options.preset](settings)
    if settings.calibrate == "ladder" and {"levels", "tiers"} & told.keys():  # which trial encodes would replace
        told = {"calibrate": "steps"} | told
    return replace(settings, **told)


def _world(options: Encode) -> World | None:
    """Returns where the scene stands, for players, as far as the options say. Raises ConfigError."""
    if options.transform:
        if options.up or options.unit is not None:
            raise ConfigError("--transform: expected neither --up nor --unit with it: it says both")
        return read_world(options.transform)
    if options.up:
        return world_from(options.up, options.unit)
    if options.unit is not None:
        raise ConfigError("--unit: expected --up with it")
    return None


def _default_target(scene: str) -> str:
    place = scene.rstrip("/") if is_address(scene) else Path(scene).resolve()  # "." has no name of its own
    return f"{place}{ENDING}"


def _open(options: Encode) -> GaussianSequence:
    """The sequence that is encoded, trained where pictures were given."""
    folder = Path(options.scene)
    if is_address(options.scene) or not is_multiview(folder):
        baking = options.baking()
        return open_frames(options.scene, quiet=options.json, views=options.views, fps=options.fps, **baking)
    if options.track:
        raise ConfigError(f"{options.scene}: expected frames for --track, got multi-view pictures, trained as one")
    if any(options.baking().values()):
        raise ConfigError(f"{options.scene}: expected a clip for --bake-fps or --duration, got multi-view pictures")
    trained = train_by_default(folder, options.fps, options.device, quiet=options.json)
    return replace(open_sequence(trained, views=options.views, fps=options.fps), credit=read_attribution(folder))


def _plan(options: Encode) -> Plan | None:
    """The plan that a file has, where one was given. Raises ConfigError, OSError for what cannot be read."""
    if options.plan == PRINTED and options.follow:
        raise ConfigError("--plan: expected a file with --follow, which prints no plan")
    if options.plan in (None, PRINTED):
        return None
    expect_plain(Path(options.plan))
    return Plan.from_json(Path(options.plan).read_bytes(), options.plan)


def _follow(options: Encode, settings: EncodeSettings, plan: Plan | None, target: str) -> int:
    whole = ("target_psnr", "target_de", "target_kb", "target_mbps", "audio", "report")
    asked = {name: getattr(options, name) for name in whole} | options.baking()
    told = [f"--{option_name(name)}" for name, value in asked.items() if value is not None]
    if option := next(iter(told), options.shared_by()):
        raise ConfigError(f"{option}: expected a sequence that is whole, got --follow, whose groups come one by one")
    if options.track:
        raise ConfigError("--track: expected a sequence that is whole, got --follow, whose groups come one by one")
    if is_address(options.scene):
        raise ConfigError(f"--follow: expected a folder of this machine, got {options.scene}")
    folder = GrowingFolder(options.scene, views=options.views, fps=options.fps)
    more = frames_may_come(options.idle)
    with Bar(options.json) as bar:
        groups = follow(folder, target, settings, plan=plan, more=more, attribution=options.attribution, progress=bar)
        report_groups(groups, target, options.json)
    return 0


def _goal(options: Encode, sequence: GaussianSequence) -> Goal | None:
    if options.target_psnr is not None:
        return Goal(PSNR, options.target_psnr)
    if options.target_de is not None:
        return Goal(DELTA_E, options.target_de)
    if options.target_kb is not None:
        return Goal(SIZE, options.target_kb)
    if options.target_mbps is not None:
        return Goal(SIZE, 1e3 / 8 * options.target_mbps / float(sequence.fps))
    return None


def _as_json(report: EncodeReport, target: str) -> dict[str, object]:
    m, rows = report.manifest, report.rows
    return {
        "package": target,
        "frames": m.frames,
        "bytes": m.media_bytes() + report.manifest_bytes,
        "top_rung_bytes": m.bytes_of(m.rung_files(0, 0)) + report.manifest_bytes,
        "seconds": {stage.about: round(stage.seconds, 3) for stage in report.stages()},
        "rows": {"matched": rows.matched, "sure": rows.sure, "unmatched": rows.unmatched, "alone": rows.alone},
        "repairs": [line for group in m.groups for line in group.repairs],
    }


def _as_words(report: EncodeReport, target: str) -> str:
    m = report.manifest
    stages = report.stages()
    parts = ", ".join(f"{stage.about} {stage.seconds:.1f}" for stage in stages if stage.seconds >= 0.05)
    package_bytes = m.media_bytes() + report.manifest_bytes
    size = f"{m.frames} frames, {float(m.frames / m.fps):.2f} s, {package_bytes / 1e6:.2f} MB with all rungs"
    return "\n".join(
        [
            format_ladder(m, report.manifest_bytes),
            "",
            f"{target}: {size}; {sum(stage.seconds for stage in stages):.0f} s ({parts})",
            f"play it: airgs-serve {target}; all tables: airgs-manifest inspect {target}",
        ]
    )
