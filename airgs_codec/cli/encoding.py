"""Options of airgs-encode that are settings of the encoder: rate, ladder, coding."""

from __future__ import annotations

import argparse
from dataclasses import fields
from typing import Any

from airgs_codec._settings import about
from airgs_codec.analysis.rows import ROWS
from airgs_codec.cli.common import add_device
from airgs_codec.cli.world import told_world
from airgs_codec.encoder.settings import (
    DEFAULT_LEVELS,
    DEFAULT_SETTINGS,
    KEYS,
    QUALITY_FACTORS,
    UPDATE_RANKS,
    EncodeSettings,
    LevelSettings,
    as_in_paper,
    as_preview,
)
from airgs_codec.errors import ConfigError
from airgs_codec.media.h264 import PRESETS
from airgs_codec.package.parse import read_region
from airgs_codec.scene.usage import MEASURES

FIELDS = tuple(field.name for field in fields(EncodeSettings))
STEPS = ("calibrated", "default")


def add_encoding(parser: argparse.ArgumentParser) -> None:
    """All of them."""
    _add_rate(parser)
    _add_ladder(parser)
    _add_coding(parser)


def _add_setting(group: argparse._ActionsContainer, option: str, name: str, **more: Any) -> None:
    """An option that is a field of EncodeSettings: its default and its help text are the field's."""
    default = getattr(DEFAULT_SETTINGS, name)
    words = f"{about(EncodeSettings, name)} (default: {default})"
    group.add_argument(option, dest=name, type=type(default), default=default, help=words, **more)


def _add_rate(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group("rate (one of these)").add_mutually_exclusive_group()
    group.add_argument(
        "--quality",
        choices=tuple(QUALITY_FACTORS),
        default="medium",
        help="factor on every quantiser step: low 1.6, medium 1, high 0.6 (default: medium)",
    )
    group.add_argument(
        "--target-psnr",
        type=float,
        metavar="DB",
        help="search for the factor at which the top rung has this PSNR, in dB",
    )
    group.add_argument(
        "--target-mb",
        type=float,
        metavar="MB",
        help="search for the factor at which all that a viewer of the top rung fetches takes so many megabytes a frame",
    )
    group.add_argument(
        "--target-mbps", type=float, metavar="MBPS", help="the same in megabits a second of playback, on average"
    )


def _add_ladder(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group("ladder")
    group.add_argument(
        "--steps",
        choices=STEPS,
        default="calibrated",
        help="calibrated: quantiser steps, levels and tiers from trial encodes of this scene, kept for the next time; "
        "default: the same for every scene (default: calibrated)",
    )
    levels = group.add_mutually_exclusive_group()
    levels.add_argument(
        "--levels",
        metavar="LIST",
        help="PRUNED:FACTOR,... for each level the percentage of the updates withheld, ascending, and a factor on the "
        "steps, instead of calibrated ones",
    )
    levels.add_argument(
        "--ladder",
        choices=("paper",),
        help="paper: eleven levels, 0 to 100 %% of the updates pruned by usage frequency alone, equal steps, one key",
    )
    _add_setting(group, "--usage", "usage", choices=MEASURES)
    _add_setting(group, "--rank", "update_rank", choices=UPDATE_RANKS)
    group.add_argument("--keep-all", action="store_true", help=about(EncodeSettings, "keep_all"))


def _add_coding(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group("coding")
    _add_setting(group, "--segment", "segment_s", metavar="S")
    _add_setting(group, "--tiles", "tiles", metavar="N")
    words = about(EncodeSettings, "group_frames")
    group.add_argument("--group", dest="group_frames", type=_group, default=None, metavar="auto|FRAMES", help=words)
    _add_setting(group, "--rows", "rows", choices=ROWS)
    _add_setting(group, "--keys", "keys", choices=KEYS)
    group.add_argument(
        "--quick",
        action="store_true",
        help="for a first look: no trial encodes, fast H.264, groups of 30 frames, few pictures measured",
    )
    _add_setting(group, "--measure-pictures", "measure_pictures", metavar="N")
    _add_setting(group, "--preset", "preset", choices=PRESETS)
    group.add_argument(
        "--threads", type=int, metavar="N", help=f"{about(EncodeSettings, 'threads')} (shared by --jobs)"
    )
    add_device(group, "where multi-view video is trained, and pictures that decide and measure are drawn")


def _group(text: str) -> int | None:
    """Frames of a group; None stands for auto."""
    if text != "auto" and not text.isdecimal():
        raise argparse.ArgumentTypeError(f"expected auto or a number of frames, got {text!r}")
    return None if text == "auto" else int(text)


def parse_levels(text: str) -> tuple[LevelSettings, ...]:
    """Levels from text: '0:1,30:1.5' has a second one with 30 % withheld and steps times 1.5. Raises ConfigError."""
    try:
        pairs = [part.split(":") for part in text.split(",")]
        return tuple(LevelSettings(float(pruned) / 100, float(factor)) for pruned, factor in pairs)
    except ValueError as error:
        raise ConfigError(f"--levels: expected PRUNED:FACTOR,…, got {text!r}") from error


def told_settings(args: argparse.Namespace) -> EncodeSettings:
    """Raises ConfigError for options that cannot work, SceneError or FormatError for a region that cannot be read."""
    chosen = parse_levels(args.levels) if args.levels else None
    calibrate = "none" if args.steps == "default" else "steps" if chosen else "ladder"
    region = read_region(args.region) if args.region else None
    known = ("quality", "steps", "levels", "region", "world", "threads")
    same = {name: getattr(args, name) for name in FIELDS if name in args and name not in known}
    settings = EncodeSettings(
        quality=QUALITY_FACTORS[args.quality],
        calibrate=calibrate,
        levels=chosen or DEFAULT_LEVELS,
        region=region,
        world=told_world(args),
        threads=args.threads or max(1, DEFAULT_SETTINGS.threads // max(1, args.jobs)),
        **same,
    )
    settings = as_in_paper(settings) if args.ladder else settings
    return as_preview(settings) if args.quick else settings
