"""A program of its own that becomes another one under limits of memory and output; it imports nothing of this package.

`python -P limited.py BYTES PROGRAM ARGUMENT...` runs a Python file or a native command in at most BYTES of address
space, with files of at most BYTES, without core dumps and with standard output thrown away. Formats are read so by
libraries that others maintain, from what strangers wrote: a crash, a bomb and printed lines stay away from ours.
"""

from __future__ import annotations

import os
import resource
import runpy
import sys


def main(limit: str, program: str, *arguments: str) -> None:
    """Limit this process, then be the program."""
    for kind in (resource.RLIMIT_AS, resource.RLIMIT_FSIZE):
        resource.setrlimit(kind, (int(limit), int(limit)))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    if not program.endswith(".py"):
        os.execv(program, [program, *arguments])
    sys.argv = [program, *arguments]
    runpy.run_path(program, run_name="__main__")


if __name__ == "__main__":
    main(*sys.argv[1:])
