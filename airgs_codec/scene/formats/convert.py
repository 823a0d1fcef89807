"""A program of its own that turns a splat file of one format into another's with gaussforge.

`python convert.py FROM TO TARGET` reads the file from standard input and writes TARGET. `limited` runs it. It imports
nothing of this package.
"""

from __future__ import annotations

import sys
from pathlib import Path


def main(source_form: str, target_form: str, target: str) -> None:
    """Convert standard input; what went wrong is the last line on standard error."""
    from gaussforge import GaussForge

    answer = GaussForge().convert(sys.stdin.buffer.read(), source_form, target_form)
    if "data" not in answer:
        sys.exit(str(answer.get("error", "no data")))
    Path(target).write_bytes(answer["data"])


if __name__ == "__main__":
    main(*sys.argv[1:])
