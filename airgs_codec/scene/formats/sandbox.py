"""Programs that read files for us with libraries that others maintain, each in a process of its own with limits.

A crash, a bomb and printed lines stay away from ours. The process runs this very file, which therefore imports nothing
of this package: `python -P sandbox.py BYTES PROGRAM ARGUMENT...` becomes one of PROGRAMS or a native command in at most
BYTES of address space, with files of at most BYTES, without core dumps and with standard output thrown away.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from fractions import Fraction
from pathlib import Path

BASE_BYTES = 4 << 30  # address space of an interpreter, its threads and a library
SECONDS = 120  # for a file of a stranger


def run_limited(
    program: str, arguments: Sequence[str], more_bytes: int, data: bytes = b"", *, seconds: float | None = SECONDS
) -> str:
    """Run a program on standard input; returns the last line of its errors, empty where all went well.

    It may take `more_bytes` of memory beyond those of any interpreter, and `seconds`.
    """
    command = [sys.executable, "-P", __file__, str(BASE_BYTES + more_bytes), program, *arguments]
    environment = os.environ | {"RUST_BACKTRACE": "0"}
    try:
        run = subprocess.run(command, input=data, capture_output=True, timeout=seconds, check=False, env=environment)
    except subprocess.TimeoutExpired:
        return f"no answer in {seconds:.0f} seconds"
    if run.returncode == 0:
        return ""
    if run.returncode < 0:
        return f"it ended with {signal.Signals(-run.returncode).name}"
    lines = [line.strip() for line in run.stderr.decode("utf-8", "replace").split("\n")]
    said = [line for line in lines if line and not line.startswith("note:")]
    return said[-1][:200] if said else "it said nothing"


def main(limit: str, program: str, *arguments: str) -> None:
    """Limit this process, then be the program; what went wrong is the last line on standard error."""
    import resource

    for kind in (resource.RLIMIT_AS, resource.RLIMIT_FSIZE):
        with suppress(ValueError):  # a lower one is set already, or macOS, which takes none of addresses
            resource.setrlimit(kind, (int(limit), int(limit)))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    if program in PROGRAMS:
        PROGRAMS[program](*arguments)
    else:
        os.execv(program, [program, *arguments])


def _convert(source_form: str, target_form: str, target: str) -> None:
    from gaussforge import GaussForge

    answer = GaussForge().convert(sys.stdin.buffer.read(), source_form, target_form)
    if "data" not in answer:
        sys.exit(str(answer.get("error", "no data")))
    Path(target).write_bytes(answer["data"])


def _bake_4dgs(fps: str, default_fps: str, most_frames: str, folder: str) -> None:
    """Bake a .4dgs on standard input with fourdgs; FPS 0 stands for as many frames as the file has states, if these are
    at least 10 a second.

    FOLDER gets 000000.npy and on, a frame's rows as float32: a mean, a quaternion w, x, y, z, sizes, alpha, RGB and SH,
    red first; and said.json, the frame rate and the kind of model. Frame i is the scene at (i + 1/2) / fps seconds, in
    the middle of its time, where what lasts for one frame is whole.
    """
    import fourdgs
    import numpy as np
    from fourdgs import opcode, records, serialization
    from fourdgs.keyframe_delta_file import decode_streamed, render_at
    from fourdgs.quantization import SH_QUANT_HI, SH_QUANT_LO

    data = sys.stdin.buffer.read()
    serialization.check_magic(data)
    found = serialization.iter_records(data, len(serialization.MAGIC))
    header = next(records.Header.parse(record.content) for record in found if record.opcode == opcode.HEADER)
    if header.temporal_model == "keyframe-delta":
        sequence = decode_streamed(data)
        pieces = len(sequence.chunks)

        def columns(t: float) -> tuple[np.ndarray, ...]:
            g = render_at(sequence, t)
            return g["centers"], g["rotations"], g["scales"], g["opacity"], g["rgb"], np.zeros((len(g["rgb"]), 0))

    else:
        scene = fourdgs.read(data)
        rows = scene.gaussians
        codes = np.zeros((rows.count, 0)) if rows.sh is None else np.reshape(rows.sh, (rows.count, -1))
        pieces = len(np.unique(rows.win_lo))

        def columns(t: float) -> tuple[np.ndarray, ...]:
            shown = scene.state_at(t)
            i = shown["indices"]
            sh = SH_QUANT_LO + codes[i] * ((SH_QUANT_HI - SH_QUANT_LO) / 255)
            return shown["centers"], shown["orientations"], rows.scales[i], shown["opacity"], rows.colors[i, :3], sh

    stated = Fraction(pieces / header.duration_sec).limit_denominator(1001)
    rate = Fraction(fps) or (stated if stated >= 10 else Fraction(default_fps))
    if not 0 < header.duration_sec * rate <= int(most_frames):
        sys.exit(f"expected 1 to {most_frames} frames, got {header.duration_sec:g} s at {rate} fps")
    for frame in range(max(1, round(header.duration_sec * rate))):
        means, turns, sizes, alpha, rgb, sh = columns((frame + 0.5) / float(rate))
        parts = (means, np.asarray(turns)[:, [3, 0, 1, 2]], sizes, np.reshape(alpha, (-1, 1)), rgb, sh)
        np.save(Path(folder, f"{frame:06d}.npy"), np.concatenate(parts, axis=1).astype("<f4"))
    Path(folder, "said.json").write_text(json.dumps([str(rate), header.temporal_model]))


PROGRAMS: dict[str, Callable[..., None]] = {"gaussforge": _convert, "fourdgs": _bake_4dgs}

if __name__ == "__main__":
    main(*sys.argv[1:])
