"""Programs that read files for us with libraries that others maintain, each in a process of its own with limits.

A crash, a bomb and printed lines stay away from ours. The process runs this very file, which therefore imports nothing
of this package: `python -P sandbox.py BYTES PROGRAM ARGUMENT...` becomes a Python file, a native command or CONVERT in
at most BYTES of address space, with files of at most BYTES, without core dumps and with standard output thrown away.
"""

from __future__ import annotations

import os
import runpy
import signal
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

BASE_BYTES = 4 << 30  # address space of an interpreter, its threads and a library
SECONDS = 120  # for a file of a stranger
CONVERT = "gaussforge"  # the program that turns a splat file of one format into another's: FROM TO TARGET
_MOST_WORDS = 200  # letters of what went wrong


def run_limited(
    program: str | Path,
    arguments: Sequence[str],
    more_bytes: int,
    data: bytes = b"",
    *,
    seconds: float | None = SECONDS,
) -> str:
    """Run a program on standard input; what it says at its end, empty where all went well.

    It has `more_bytes` of memory beyond what any interpreter takes, and so many seconds.
    """
    command = [sys.executable, "-P", __file__, str(BASE_BYTES + more_bytes), str(program), *arguments]
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
    return said[-1][:_MOST_WORDS] if said else "it said nothing"


def main(limit: str, program: str, *arguments: str) -> None:
    """Limit this process, then be the program."""
    import resource

    for kind in (resource.RLIMIT_AS, resource.RLIMIT_FSIZE):
        resource.setrlimit(kind, (int(limit), int(limit)))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    if program == CONVERT:
        _convert(*arguments)
    elif program.endswith(".py"):
        sys.argv = [program, *arguments]
        runpy.run_path(program, run_name="__main__")
    else:
        os.execv(program, [program, *arguments])


def _convert(source_form: str, target_form: str, target: str) -> None:
    """Convert standard input; what went wrong is the last line on standard error."""
    from gaussforge import GaussForge

    answer = GaussForge().convert(sys.stdin.buffer.read(), source_form, target_form)
    if "data" not in answer:
        sys.exit(str(answer.get("error", "no data")))
    Path(target).write_bytes(answer["data"])


if __name__ == "__main__":
    main(*sys.argv[1:])
