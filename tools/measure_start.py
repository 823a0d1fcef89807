"""How long a user waits before anything happens: importing the package, and looking into one.

    python -m tools.measure_start [PACKAGE]

Every figure is the median of RUNS fresh processes, in seconds: the import of airgs_codec as `python -X importtime`
counts it, and, where a PACKAGE is given, `airgs-manifest inspect PACKAGE` once its modules are loaded. Exit status 1
when one is over its limit.
"""

from __future__ import annotations

import argparse
import re
import statistics
import subprocess
import sys
from pathlib import Path

RUNS = 5
IMPORT_LIMIT_S, INSPECT_LIMIT_S = 0.15, 1.0
INSPECT = """
import sys, time
from airgs_codec.cli.manifest import main
start = time.perf_counter()
main(["inspect", sys.argv[1]])
print("seconds", time.perf_counter() - start, file=sys.stderr)
"""


def measure(command: list[str], pattern: str, unit_s: float) -> float:
    """Median over RUNS processes of the number that `pattern` finds last on stderr, times `unit_s`."""
    outputs = [subprocess.run(command, capture_output=True, text=True, check=True).stderr for _ in range(RUNS)]
    return statistics.median(unit_s * float(re.findall(pattern, output)[-1]) for output in outputs)


def import_s() -> float:
    """Seconds of `import airgs_codec`, with everything it loads."""
    command = [sys.executable, "-X", "importtime", "-c", "import airgs_codec"]
    return measure(command, r"\|\s+(\d+) \| +airgs_codec\n", 1e-6)


def inspect_s(package: Path) -> float:
    """Seconds of `airgs-manifest inspect` after its imports."""
    return measure([sys.executable, "-c", INSPECT, str(package)], r"seconds ([\d.e-]+)", 1.0)


def main() -> int:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("package", type=Path, nargs="?")
    args = parser.parse_args()
    figures = [("import airgs_codec", import_s(), IMPORT_LIMIT_S)]
    if args.package:
        figures.append(("airgs-manifest inspect", inspect_s(args.package), INSPECT_LIMIT_S))
    for name, seconds, limit in figures:
        print(f"{name:<24}{seconds:8.3f} s, at most {limit:g} s{'' if seconds <= limit else ': too slow'}")
    return int(any(seconds > limit for _, seconds, limit in figures))


if __name__ == "__main__":
    sys.exit(main())
