"""Mutated files of every kind that others give us: each is read, or refused in one line that says why.

    python -m tests.long.fuzz [--count 100000] [--seed 0] [--jobs 2] [--only TARGET]

Anything else is a finding: another exception, other Gaussians than the files were made of, more than SECONDS, more than
MEMORY. The number of a finding makes it again: `--seed NUMBER --count 1`. Workers that crash or hang are replaced.
"""

from __future__ import annotations

import argparse
import faulthandler
import json
import random
import resource
import subprocess
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

from airgs_codec.errors import AirgsError, FormatError
from tests.long.targets import TARGETS, Target, seeds
from tests.support.paths import REPOSITORY

SECONDS = 10.0  # for a case
MEMORY = 1 << 30  # that a case may take beyond what its worker has
_ADDRESSES = 8 << 30  # of a worker in all, of which threads and libraries take much that they never use


@cache
def expected(target: Target, seed: int) -> str:
    return target.use(seeds(target)[seed])


def attempt(number: int, only: str = "") -> tuple[str, str, str]:
    """The target of a case; "read" or why it is refused; and what was found, if anything was."""
    chance = random.Random(number)
    (target,) = chance.choices(TARGETS, [t.weight * (only in ("", t.name)) for t in TARGETS])
    seed = chance.randrange(len(seeds(target)))
    files, free = target.change(chance, seeds(target)[seed])
    outcome, finding, (before, children) = "read", "", _begin()
    try:
        found = target.use(files)
    except AirgsError as error:
        found, outcome = None, error.reason if isinstance(error, FormatError) else type(error).__name__
        if "\n" in str(error) or "\x1b" in str(error):
            finding = f"no plain line: {error!r}"
    except Exception as error:  # whatever it is, it is what we look for
        found, place = None, traceback.extract_tb(error.__traceback__)[-1]
        finding = f"{type(error).__name__} at {Path(place.filename).name}:{place.lineno}: {error}"
    faulthandler.cancel_dump_traceback_later()
    most = max(_memory("VmHWM") - before, _children() if _children() > children else 0)
    if most > MEMORY:
        finding = finding or f"{most >> 20} MB, {outcome}"
    if found is not None and not free and found != expected(target, seed):
        finding = "other Gaussians than before"
    return target.name, outcome, finding


def _begin() -> tuple[int, int]:
    """Start the clock, which ends this process, and the count of memory; bytes in use, and the peak of a child."""
    faulthandler.dump_traceback_later(SECONDS, exit=True)
    Path("/proc/self/clear_refs").write_text("5")  # the peak begins anew
    return _memory("VmRSS"), _children()


def _children() -> int:
    """Bytes of the largest process so far that read a file for this one."""
    return 1024 * resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss


def _memory(name: str) -> int:
    """Bytes of this process, as the kernel counts them."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return 1024 * next(int(line.split()[1]) for line in lines if line.startswith(name))


def work(start: int, stop: int, only: str = "") -> None:
    resource.setrlimit(resource.RLIMIT_AS, (_ADDRESSES, _ADDRESSES))
    warnings.simplefilter("ignore")
    for number in range(start, stop):
        print(json.dumps(attempt(number, only)), flush=True)


@dataclass(slots=True)
class Tally:
    counts: dict[str, Counter[str]] = field(default_factory=dict)  # outcomes by target
    findings: dict[str, list[int]] = field(default_factory=dict)  # numbers of cases

    def run(self, start: int, stop: int, only: str = "") -> None:
        """Try cases in a process of its own, in another one after each that ends it."""
        while start < stop:
            words = [sys.executable, "-m", "tests.long.fuzz", "--worker", str(start), str(stop), "--only", only]
            with tempfile.TemporaryFile("w+") as said:
                with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=said, text=True, cwd=REPOSITORY) as worker:
                    for line in worker.stdout or ():
                        name, outcome, finding = json.loads(line)
                        self.counts.setdefault(name, Counter())[outcome] += not finding
                        if finding:
                            self._add(f"{name}: {finding[:300]}", start)
                        start += 1
                if worker.returncode:
                    said.seek(0)
                    text = said.read()
                    place = text.partition("Timeout")[2].split("\n")[2:5] or text.splitlines()[-1:]
                    self._add(f"the worker ended with {worker.returncode}: {' '.join(place)}", start)
                    start += 1

    def _add(self, finding: str, number: int) -> None:
        if finding not in self.findings:
            print(f"{number}: {finding}", flush=True)
        self.findings.setdefault(finding, []).append(number)


def main() -> None:
    """Share out, collect, print; exit code 1 if there is a finding."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=100_000)
    parser.add_argument("--seed", type=int, default=0, help="first number")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--only", default="", choices=["", *(target.name for target in TARGETS)])
    parser.add_argument("--worker", type=int, nargs=2, help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.worker:
        work(args.worker[0], args.worker[1], args.only)
        return
    began, tally = time.perf_counter(), Tally()
    bounds = [args.seed + args.count * i // args.jobs for i in range(args.jobs + 1)]
    with ThreadPoolExecutor(args.jobs) as pool:
        list(pool.map(tally.run, bounds, bounds[1:], [args.only] * args.jobs))
    print(f"{args.count} cases in {time.perf_counter() - began:.0f} s, {len(tally.findings)} findings")
    for name, counts in tally.counts.items():
        print(f"{counts.total():8d}  {name}: {', '.join(f'{count} {text}' for text, count in counts.most_common())}")
    for finding, numbers in tally.findings.items():
        print(f"{len(numbers)} times, as in case {numbers[0]}: {finding}")
    sys.exit(bool(tally.findings))


if __name__ == "__main__":
    main()
