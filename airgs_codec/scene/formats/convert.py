"""A program of its own that turns a splat file of one format into another's with gaussforge.

`python -P convert.py FROM TO TARGET BYTES` reads the file from standard input and writes TARGET, in at most BYTES of
address space. The library is native code that reads what strangers wrote, and it prints to standard output: a process
of its own keeps a crash, a bomb and those lines away from ours. It imports nothing of this package.
"""

from __future__ import annotations

import os
import resource
import sys
from pathlib import Path


def main(source_form: str, target_form: str, target: str, limit: str) -> None:
    """Convert standard input; what went wrong is the last line on standard error."""
    resource.setrlimit(resource.RLIMIT_AS, (int(limit), int(limit)))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    from gaussforge import GaussForge

    answer = GaussForge().convert(sys.stdin.buffer.read(), source_form, target_form)
    if "data" not in answer:
        sys.exit(str(answer.get("error", "no data")))
    Path(target).write_bytes(answer["data"])


if __name__ == "__main__":
    main(*sys.argv[1:])
