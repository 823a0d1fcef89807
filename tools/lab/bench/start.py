"""How long a user waits before anything happens: importing the package, and looking into one.

Every figure is the median of RUNS fresh processes: the import of airgs_codec as `python -X importtime` counts it, and,
where a package is given, `airgs-manifest inspect` once its modules are loaded. Exit status 1 where one is too slow.
"""

from __future__ import annotations

import re
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from statistics import median

from tools.lab import Lab, Page, Section, Table, setting

RUNS = 5
IMPORT_LIMIT_S, INSPECT_LIMIT_S = 0.15, 1.0
INSPECT = """
import sys, time
from airgs_codec.cli.manifest import main
start = time.perf_counter()
main(["inspect", sys.argv[1]])
print("seconds", time.perf_counter() - start, file=sys.stderr)
"""


@dataclass(frozen=True, slots=True)
class Options:
    """What is begun."""

    package: Path | None = setting(None, "a package to look into")


def run(options: Options, lab: Lab) -> Page:
    """Begin both."""
    words = ["-X", "importtime", "-c", "import airgs_codec"]
    begun = [("import airgs_codec", 1e-6 * measure(words, r"\|\s+(\d+) \| +airgs_codec\n"), IMPORT_LIMIT_S)]
    if options.package:
        seconds = measure(["-c", INSPECT, str(options.package)], r"seconds ([\d.e-]+)")
        begun.append(("airgs-manifest inspect", seconds, INSPECT_LIMIT_S))
    rows = [{"begun": name, "seconds": seconds, "at most": limit} for name, seconds, limit in begun]
    slow = [name for name, seconds, limit in begun if seconds > limit]
    answer = f"Too slow: {', '.join(slow)}." if slow else "Everything begins in time."
    return Page([Section(answer, tables=[Table("start", rows)])], failed=bool(slow))


def measure(words: list[str], pattern: str) -> float:
    """Median over RUNS processes of Python of the number that `pattern` finds last on stderr."""
    runs = (subprocess.run([sys.executable, *words], capture_output=True, text=True, check=True) for _ in range(RUNS))
    return median(float(re.findall(pattern, done.stderr)[-1]) for done in runs)
