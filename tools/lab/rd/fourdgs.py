"""Avala's .4dgs as the PyPI package fourdgs writes it, the whole sequence in one file.

Either as its converter writes it out of .ply frames, where Gaussians live for a frame, or in the model keyframe-delta,
where frames are differences to the one before and groups begin with a keyframe; its writer has no SH, and no command.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path

from airgs_codec.scene.formats.ply import write_ply
from airgs_codec.scene.sequence import open_sequence
from tools.lab import seconds_of
from tools.lab.rd.programs import run_program
from tools.lab.rd.subject import Coded, Subject, Trial

PROFILES = ("fine", "default", "coarse")
CONVERT = ("-m", "fourdgs.cli", "convert")
DELTA = """
import sys, numpy as np
from pathlib import Path
from fourdgs.convert import GaussianSet, convert_ply_sequence
from fourdgs.keyframe_delta_file import write_sequence
from fourdgs.keyframe_delta_writer import KeyframeDeltaOptions, Sample
source, _, packed, _, fps, _, profile, *starts = sys.argv[1:]
g, duration = convert_ply_sequence(source, fps=float(fps))
samples = []
for start in np.unique(g.win_lo):
    rows = g.win_lo == start
    n = int(rows.sum())
    whole = dict(win_lo=np.zeros(n), win_hi=np.full(n, duration), sigma_t=np.full(n, 1e3 * duration))
    still = dict(motions=np.zeros((n, 3)), mu_t=np.full(n, start))
    kept = {name: getattr(g, name)[rows] for name in ("positions", "scales", "rotations", "colors")}
    samples.append(Sample(float(start) if len(samples) else 0.0, np.arange(n), GaussianSet(**kept, **still, **whole)))
kd = KeyframeDeltaOptions(keyframe_every=len(samples) + 1, keyframe_at=tuple(map(int, starts)))
Path(packed).write_bytes(write_sequence(samples, duration, kd=kd, profile=profile, level=9))
"""


def fourdgs_trials(python: str) -> Iterator[Trial]:
    """Both at every profile; `python` is that of an environment in which fourdgs is installed."""
    for profile in PROFILES:
        yield Trial("4dgs", profile, partial(_coded, [python, *CONVERT], profile, False))
    for profile in PROFILES:
        yield Trial("4dgs, keyframe-delta", profile, partial(_coded, [python, "-c", DELTA], profile, True))


def _coded(program: Sequence[str], profile: str, names_groups: bool, subject: Subject) -> Coded:
    """Read back by this package, which asks the library; seconds of decoding are of the measured frames."""
    fps = float(subject.sequence.fps)
    with tempfile.TemporaryDirectory() as folder:
        source, packed = Path(folder) / "frames", Path(folder) / "scene.4dgs"
        source.mkdir()
        for number in range(len(subject.sequence)):
            write_ply(source / f"{number:06d}.ply", subject.frame(number))
        words = [*program, str(source), "-o", str(packed), "--fps", f"{fps:g}", "--profile", profile]
        starts = [str(start) for start, _ in subject.groups] if names_groups else []
        encode_s = run_program([*words, *starts])[0]
        back = open_sequence(packed, bake_fps=fps)
        took, shown = seconds_of(lambda: {number: back.read(number) for number in subject.measured})
        size = packed.stat().st_size
    return Coded(size / len(subject.sequence), shown, encode_s, took.wall)
