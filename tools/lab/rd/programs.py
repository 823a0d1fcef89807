"""Coders of others, run as outside programs that this project does not depend on: each is measured where it is given.

- splat-transform (npm, @playcanvas/splat-transform): SPZ, SOG and compressed .ply, every frame on its own.
- splat4d (PyPI, splats4d): .splat4d, group by group. Its input, .splat, has 8-bit colours and rotations, and no SH but
  the first coefficient.
- 4dgs (PyPI, fourdgs): .4dgs as its converter writes it out of .ply frames, the whole sequence in one file.
"""

from __future__ import annotations

import shlex
import subprocess
import tempfile
from collections.abc import Iterator
from fractions import Fraction
from functools import partial
from pathlib import Path

import numpy as np

from airgs_codec.errors import ConfigError
from airgs_codec.scene.formats.ply import read_ply, write_ply
from airgs_codec.scene.formats.splat import read_splat
from airgs_codec.scene.formats.write import choose_target, write_frames
from airgs_codec.scene.gaussians import SH_C0, Gaussians
from tools.lab.rd.layouts import SMALLEST_SCALE, to_logit
from tools.lab.rd.subject import Coded, Subject, Trial
from tools.lab.timing import seconds_of

STATIC_FORMATS = {"SPZ": "spz", "SOG": "sog", "compressed .ply": "compressed.ply"}
# Bounds of position (thousandths of a world unit), colour (8-bit levels), rotation (1/128) and scale (per cent).
SPLAT4D_BOUNDS = ((0.25, 1, 0, 0.5), (0.5, 1, 0, 1), (1, 2, 0, 2), (2, 4, 0, 2), (4, 6, 1, 4), (8, 8, 2, 8))
FOURDGS_PROFILES = ("fine", "default", "coarse")
FOURDGS_READ = """
import sys, time, fourdgs, numpy as np
from fourdgs.quantization import SH_QUANT_HI, SH_QUANT_LO
began = time.perf_counter()
g = fourdgs.read(sys.argv[1]).gaussians
for t in map(float, sys.argv[3:]):
    state = g.state_at(t)
    rows = state["indices"]
    sh = g.sh[rows] / 255 * (SH_QUANT_HI - SH_QUANT_LO) + SH_QUANT_LO if g.sh_degree else np.zeros((len(rows), 0))
    np.savez(f"{sys.argv[2]}/{t}.npz", means=state["centers"], xyzw=state["orientations"], scales=g.scales[rows],
             opacity=state["opacity"], colour=g.colors[rows, :3], sh_rest=sh)
print(time.perf_counter() - began)
"""


def splat_transform_trials(command: str) -> Iterator[Trial]:
    """One setting of each static format; `command` such as 'splat-transform -g cpu'."""
    for name, ending in STATIC_FORMATS.items():
        yield Trial(name, "default", partial(_static, shlex.split(command), ending))


def _static(command: list[str], ending: str, subject: Subject) -> Coded:
    """Measured frames only; seconds are scaled to the whole sequence."""
    size, encode_s, decode_s = 0, 0.0, 0.0
    shown: dict[int, Gaussians] = {}
    with tempfile.TemporaryDirectory() as folder:
        for number in subject.measured:
            source, packed, back = (Path(folder) / f"{number}{end}" for end in (".ply", f".{ending}", ".back.ply"))
            write_ply(source, subject.frame(number))
            encode_s += _run([*command, "--overwrite", "--quiet", str(source), str(packed)])[0]
            decode_s += _run([*command, "--overwrite", "--quiet", str(packed), str(back)])[0]
            size += packed.stat().st_size
            shown[number] = read_ply(back)
    scale = len(subject.sequence) / len(subject.measured)
    return Coded(size / len(subject.measured), shown, scale * encode_s, scale * decode_s)


def splat4d_trials(command: str) -> Iterator[Trial]:
    """From finer to coarser bounds than its defaults, at its strongest compression of them."""
    names = ("--pos-mm", "--color-levels", "--rot-steps", "--scale-pct")
    for bounds in SPLAT4D_BOUNDS:
        options = [word for pair in zip(names, map(str, bounds), strict=True) for word in pair]
        yield Trial("splat4d", f"{bounds[0]:g} mm", partial(_splat4d, shlex.split(command), options))


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
            encode_s += _run([*command, "encode", "-i", folder, "-o", str(packed), *rate, *options])[0]
            size += packed.stat().st_size
            for number in set(subject.measured) & set(range(start, start + len(frames))):
                words = ["decode", str(packed), "--frame", str(number - start), "-o", str(back)]
                decode_s += _run([*command, *words])[0]
                shown[number] = read_splat(back)
    scale = len(subject.sequence) / len(subject.measured)
    return Coded(size / len(subject.sequence), shown, encode_s, scale * decode_s)


def fourdgs_trials(python: str) -> Iterator[Trial]:
    """Every profile of the converter; `python` is that of an environment in which fourdgs is installed."""
    for profile in FOURDGS_PROFILES:
        yield Trial("4dgs", profile, partial(_fourdgs, python, profile))


def _fourdgs(python: str, profile: str, subject: Subject) -> Coded:
    """Each frame is shown at the middle of its time, where its Gaussians are as they were given."""
    fps = float(subject.sequence.fps)
    with tempfile.TemporaryDirectory() as folder:
        source, packed = Path(folder) / "frames", Path(folder) / "scene.4dgs"
        source.mkdir()
        for number in range(len(subject.sequence)):
            write_ply(source / f"{number:06d}.ply", subject.frame(number))
        options = ["--fps", f"{fps:g}", "--profile", profile]
        encode_s = _run([python, "-m", "fourdgs.cli", "convert", str(source), "-o", str(packed), *options])[0]
        times = {number: (number + 0.5) / fps for number in subject.measured}
        words = [python, "-c", FOURDGS_READ, str(packed), folder, *map(str, times.values())]
        decode_s = float(_run(words)[1])
        shown = {number: _read_state(Path(folder) / f"{t}.npz") for number, t in times.items()}
        size = packed.stat().st_size
    return Coded(size / len(subject.sequence), shown, encode_s, decode_s)


def _read_state(path: Path) -> Gaussians:
    """An instant of a .4dgs scene, as FOURDGS_READ keeps it."""
    with np.load(path) as state:
        columns = {
            "means": state["means"],
            "quaternions": state["xyzw"][:, [3, 0, 1, 2]],
            "log_scales": np.log(np.maximum(state["scales"], SMALLEST_SCALE)),
            "opacity_logits": to_logit(state["opacity"]),
            "sh_dc": (state["colour"] - 0.5) / SH_C0,
            "sh_rest": state["sh_rest"].reshape(len(state["means"]), 3, -1).transpose(0, 2, 1),
        }
    return Gaussians(**{name: np.ascontiguousarray(values, np.float32) for name, values in columns.items()})


def _run(words: list[str]) -> tuple[float, str]:
    """Seconds and output of a program. Raises ConfigError where it fails or is not there."""
    try:
        took, done = seconds_of(lambda: subprocess.run(words, check=False, capture_output=True, text=True, timeout=600))
    except OSError as error:
        raise ConfigError(f"{words[0]}: expected a program, got {error.strerror}") from error
    if done.returncode:
        raise ConfigError(f"{shlex.join(words)[:200]}: {(done.stderr or done.stdout).strip()[-300:]}")
    return took.wall, done.stdout
