"""A program of its own that turns one splat file into INRIA .ply with gaussforge; it imports nothing of this package.

`python -P convert.py FORM TARGET BYTES` reads the file from standard input and writes TARGET, in at most BYTES of
address space. The library is native code that reads what strangers wrote, and it prints to standard output: a process
of its own keeps a crash, a bomb and those lines away from ours.
"""

from __future__ import annotations

import os
import resource
import sys
from pathlib import Path


def main(form: str, target: str, limit: str) -> None:
    """Convert standard input; what went wrong is the last line on standard error."""
    resource.setrlimit(resource.RLIMIT_AS, (int(limit), int(limit)))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    from gaussforge import GaussForge

    answer = GaussForge().convert(sys.stdin.buffer.read(), form, "ply")
    if "data" not in answer:
        sys.exit(str(answer.get("error", "no data")))
    Path(target).write_bytes(answer["data"])


if __name__ == "__main__":
    main(*sys.argv[1:])
