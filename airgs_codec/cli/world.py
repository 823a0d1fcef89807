"""The options that tell which way is up and how long a unit is."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from airgs_codec.errors import ConfigError
from airgs_codec.package.tables import World
from airgs_codec.package.world import AXES, parse_up, read_world, world_from


def add_world(parser: argparse.ArgumentParser) -> None:
    """Add --up, --scale and --transform."""
    group = parser.add_argument_group("which way is up (kept for players; nothing is turned or scaled)")
    group.add_argument(
        "--up",
        metavar="AXIS",
        help=f"{', '.join(AXES)} or X,Y,Z: the direction that points up in the frames (default: y for .spz and glTF, "
        "whose specifications say so, what a .4dgs says; for others nothing is told)",
    )
    group.add_argument(
        "--scale", type=float, metavar="METRES", help="with --up: how many metres a unit of the frames is long"
    )
    group.add_argument(
        "--transform",
        type=Path,
        metavar="FILE",
        help="instead of these: 3x4 or 4x4 numbers row by row, text or JSON, from the frames to a world with y up in "
        "metres: a turn, one scale, a shift",
    )


def told_world(args: argparse.Namespace) -> World | None:
    """Where the scene stands, as far as the options say. Raises ConfigError."""
    if args.transform:
        if args.up or args.scale is not None:
            raise ConfigError("--transform: expected neither --up nor --scale with it: it says both")
        return read_world(args.transform)
    if args.up:
        return world_from(parse_up(args.up), args.scale)
    if args.scale is not None:
        raise ConfigError("--scale: expected --up with it")
    return None


def with_signs(argv: Sequence[str]) -> list[str]:
    """Arguments in which --up -y, of which argparse would take -y for an option, is --up=-y."""
    joined: list[str] = []
    for argument in argv:
        if joined and joined[-1] == "--up" and argument.startswith("-") and not argument.startswith("--"):
            joined[-1] = f"--up={argument}"
        else:
            joined.append(argument)
    return joined
