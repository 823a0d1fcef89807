"""The options that tell how a clip becomes frames."""

from __future__ import annotations

import argparse
from fractions import Fraction
from typing import TypedDict

from airgs_codec.cli.common import fraction


class Baking(TypedDict):
    """Arguments of `open_sequence`; None: what the file says, or else the default of its format."""

    bake_fps: Fraction | None
    duration: Fraction | None


UNTOLD: Baking = {"bake_fps": None, "duration": None}


def add_baking(parser: argparse._ActionsContainer) -> None:
    """Add --bake-fps and --duration."""
    parser.add_argument(
        "--bake-fps",
        type=fraction,
        metavar="FPS",
        help="frames a second that a clip of moving Gaussians is baked to (default: what the file says, else 30)",
    )
    parser.add_argument(
        "--duration",
        type=fraction,
        metavar="SECONDS",
        help="length of a clip whose file states none: .splatv, Spacetime Gaussians .ply (default: 5/3)",
    )


def told_baking(args: argparse.Namespace) -> Baking:
    """What the options say."""
    return {"bake_fps": args.bake_fps, "duration": args.duration}


def is_told(baking: Baking) -> bool:
    """Whether any option was given."""
    return baking != UNTOLD
