"""Coders of others, run as outside programs that this project does not depend on: each is measured where it is given.

- splat-transform (npm, @playcanvas/splat-transform): SPZ, SOG and compressed .ply, a file a frame.
- splat4d (PyPI, splats4d): .splat4d, group by group. Its input, .splat, has 8-bit colours and rotations, and no SH but
  the first coefficient.
- 4dgs (PyPI, fourdgs): in `fourdgs`.
"""

from __future__ import annotations

import shlex
import subprocess
import tempfile
from collections.abc import Iterator, Sequence
from fractions import Fraction
from functools import partial
from pathlib import Path

from airgs_codec.errors import ConfigError
from airgs_codec.scene.formats.packed import read_splat
from airgs_codec.scene.formats.ply import read_ply, write_ply
from airgs_codec.scene.formats.table import choose_target, write_frames
from airgs_codec.scene.gaussians import Gaussians
from tools.lab import seconds_of
from tools.lab.rd.subject import Coded, Subject, Trial

SPZ = "SPZ"
STATIC_SETTINGS = (  # coder, setting, ending, options
    (SPZ, "version 4", "spz", ()),
    (SPZ, "version 3", "spz", ("--spz-version", "3")),
    ("SOG", "10 rounds", "sog", ()),
    ("SOG", "50 rounds", "sog", ("--iterations", "50")),
    ("compressed .ply", "default", "compressed.ply", ()),
)
# Bounds of position (thousandths of a world unit), colour (8-bit levels), rotation (1/128) and scale (per cent); the
# last ones for scenes of less than a unit.
SPLAT4D_BOUNDS = (
    (0.1, 0, 0, 0.25), (0.25, 1, 0, 0.5), (0.5, 1, 0, 1), (1, 2, 0, 2), (2, 4, 0, 2), (4, 6, 1, 4), (8, 8, 2, 8),
    (16, 12, 2, 12), (32, 16, 4, 16), (0.1, 8, 2, 8), (0.2, 8, 2, 8), (0.4, 8, 2, 8),
)  # fmt: skip


def splat_transform_trials(command: str) -> Iterator[Trial]:
    """Every static format at its settings; `command` such as 'splat-transform -g cpu'."""
    for name, chosen, ending, options in STATIC_SETTINGS:
        yield Trial(name, chosen, partial(_static, shlex.split(command), ending, options))


def _static(command: list[str], ending: str, options: Sequence[str], subject: Subject) -> Coded:
    """Measured frames only; seconds are scaled to the whole sequence."""
    size, encode_s, decode_s = 0, 0.0, 0.0
    shown: dict[int, Gaussians] = {}
    with tempfile.TemporaryDirectory() as folder:
        for number in subject.measured:
            source, packed, back = (Path(folder) / f"{number}{end}" for end in (".ply", f".{ending}", ".back.ply"))
            write_ply(source, subject.frame(number))
            encode_s += run_program([*command, "--overwrite", "--quiet", *options, str(source), str(packed)])[0]
            decode_s += run_program([*command, "--overwrite", "--quiet", str(packed), str(back)])[0]
            size += packed.stat().st_size
            shown[number] = read_ply(back)
    scale = len(subject.sequence) / len(subject.measured)
    return Coded(size / len(subject.measured), shown, scale * encode_s, scale * decode_s)


def splat4d_trials(command: str) -> Iterator[Trial]:
    """Finer and coarser bounds than its defaults, at its strongest compression of them."""
    names = ("--pos-mm", "--color-levels", "--rot-steps", "--scale-pct")
    for bounds in SPLAT4D_BOUNDS:
        options = [word for pair in zip(names, map(str, bounds), strict=True) for word in pair]
        yield Trial("splat4d", " ".join(map(str, bounds)), partial(_splat4d, shlex.split(command), options))


def _splat4d(command: list[str], options: list[str], subject: Subject) -> Coded:
    """Seconds of decoding are those of the measured frames, each a process, scaled to the whole sequence."""
    size, encode_s, decode_s = 0, 0.0, 0.0
    shown: dict[int, Gaussians] = {}
    rate = ["--fps", f"{float(subject.sequence.fps):g}", "--zstd-level", "19", "--no-verify"]
    for start, frames in subject.groups:
        with tempfile.TemporaryDirectory() as folder:
            packed, back = Path(folder) / "group.splat4d", Path(folder) / "back"
            for i, frame in enumerate(frames):
                write_frames(choose_target(f"{folder}/frame_{i:04d}.splat", None, 1), [(0, frame)], Fraction(1))
            encode_s += run_program([*command, "encode", "-i", folder, "-o", str(packed), *rate, *options])[0]
            size += packed.stat().st_size
            for number in set(subject.measured) & set(range(start, start + len(frames))):
                words = ["decode", str(packed), "--frame", str(number - start), "-o", str(back)]
                decode_s += run_program([*command, *words])[0]
                shown[number] = read_splat(back)
    scale = len(subject.sequence) / len(subject.measured)
    return Coded(size / len(subject.sequence), shown, encode_s, scale * decode_s)


def run_program(words: list[str]) -> tuple[float, str]:
    """Seconds and output of a program. Raises ConfigError where it fails or is not there."""
    try:
        took, done = seconds_of(lambda: subprocess.run(words, check=False, capture_output=True, text=True, timeout=600))
    except OSError as error:
        raise ConfigError(f"{words[0]}: expected a program, got {error.strerror}") from error
    if done.returncode:
        raise ConfigError(f"{shlex.join(words)[:200]}: {(done.stderr or done.stdout).strip()[-300:]}")
    return took.wall, done.stdout
