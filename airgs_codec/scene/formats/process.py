"""Programs that read files for us, each in a process of its own with limits of time and memory."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

BASE_BYTES = 4 << 30  # address space of an interpreter, its threads and a library
SECONDS = 120  # for a file of a stranger
_LIMITED = Path(__file__).with_name("limited.py")
_MOST_WORDS = 200  # letters of what went wrong


def run_limited(
    program: Path,
    arguments: Sequence[str],
    more_bytes: int,
    data: bytes = b"",
    *,
    seconds: float | None = SECONDS,
) -> str:
    """Run a Python file or a native command on standard input; what it says at its end, empty where all went well.

    It has `more_bytes` of memory beyond what any interpreter takes, and so many seconds.
    """
    command = [sys.executable, "-P", str(_LIMITED), str(BASE_BYTES + more_bytes), str(program), *arguments]
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
