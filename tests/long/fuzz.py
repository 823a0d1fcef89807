"""Mutated packages: each decodes, or is refused with a reason; never a crash, a hang, a traceback or endless memory.

    python -m tests.long.fuzz [--count 100000] [--seed 0] [--jobs 2]

Files of the packages under manifests/valid are mutated one or two at a time: tables by their structure and by their
bytes, manifest.mpd, sidecars, init and media segments by their bytes. In most inputs lengths and digests are
made to agree, so that what lies behind the digests is reached; of the others, those that decode must decode to the
same Gaussians. Every worker may use MEMORY bytes, every input SECONDS. Prints what was found, with the number that
makes it again.
"""

from __future__ import annotations

import argparse
import hashlib
import itertools
import json
import random
import resource
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, fields
from functools import cache, partial
from types import FrameType

import numpy as np

from airgs_codec.decoder.decode import decode_canonical, decode_segment
from airgs_codec.errors import AirgsError, FormatError
from airgs_codec.package.mpd_check import check_mpd
from airgs_codec.package.package import Package, check_digest, open_manifest
from airgs_codec.package.parse import parse_root
from airgs_codec.package.paths import JSON_NAME, MPD_NAME, FileKind, file_kind
from airgs_codec.package.tables import FileEntry
from airgs_codec.places.place import Folder
from airgs_codec.scene.gaussians import Gaussians
from tests.support.mutations import Files, apply, by_chance, honest, read_files
from tests.support.paths import VALID

MEMORY = 4 << 30
SECONDS = 20.0


@dataclass(frozen=True, slots=True, eq=False)
class Memory(Package):
    """A package that lies in memory; digests are checked for tables alone."""

    contents: dict[str, bytes] = field(default_factory=dict)

    def read(self, relative: str) -> bytes:
        """A file of the package."""
        return read_from(self.contents, relative, self.manifest.entry(relative))


def read_from(files: Files, relative: str, entry: FileEntry) -> bytes:
    """One of some files, if it has the right length."""
    data = files.get(relative)
    if data is None:
        raise FormatError("missing_file", relative, "expected a file, got nothing")
    if len(data) != entry.bytes:
        raise FormatError("size_mismatch", relative, f"expected {entry.bytes} bytes, got {len(data)}")
    if file_kind(relative) is FileKind.MANIFESTS:
        check_digest(relative, data, entry)
    return data


@cache
def corpus() -> list[Files]:
    """Every valid package."""
    return [read_files(folder) for folder in sorted(VALID.iterdir()) if folder.name != "paged"]  # many small files


@cache
def decoded(index: int) -> bytes:
    """Digest of all that a package of the corpus decodes to."""
    return decode_all(corpus()[index])


def decode_all(files: Files) -> bytes:
    """Open, check and decode a package in memory; the digest of all Gaussians. Raises AirgsError for a bad one."""
    manifest = open_manifest(parse_root(files[JSON_NAME]), partial(read_from, files))
    check_mpd(files[MPD_NAME], manifest)
    package = Memory(Folder(VALID), manifest, 0, 0, files)
    digest = hashlib.sha256()
    with np.errstate(all="ignore"):
        for gaussians in _decoded(package):
            for attribute in fields(gaussians):
                digest.update(getattr(gaussians, attribute.name).tobytes())
    return digest.digest()


def _decoded(package: Package) -> Iterator[Gaussians]:
    """The Gaussians of every group in every key quality, and of every frame of every segment at every level."""
    m = package.manifest
    for group in range(len(m.groups)):
        bases = [decode_canonical(package, group, quality) for quality in range(len(m.qualities))]
        yield from (base.to_gaussians() for base in bases)
        for index in m.segments_of(group):
            for level in range(len(m.levels)):
                frames = range(m.segments[index].stop - m.segments[index].start)
                yield from decode_segment(package, index, bases[0], level, frames)


def mutant(number: int) -> tuple[int, Files, bool]:
    """(which package of the corpus, its files with one or two changes, whether digests agree) of a number."""
    chance = random.Random(number)
    index = chance.randrange(len(corpus()))
    agree = chance.random() < 0.8
    files = apply(corpus()[index], *[by_chance(chance)] * chance.choice((1, 1, 2)))
    return index, honest(files) if agree else files, agree


def try_mutant(number: int) -> str:
    """Decode one: "decodes" or the reason it is refused for; any other exception is a finding and leaves."""
    index, files, agree = mutant(number)
    try:
        result = decode_all(files)
    except FormatError as error:
        return error.reason
    except AirgsError as error:
        return type(error).__name__
    same = all(files[name] == data for name, data in corpus()[index].items() if name not in (JSON_NAME, MPD_NAME))
    if not agree and same and files[JSON_NAME] == corpus()[index][JSON_NAME] and result != decoded(index):
        raise AssertionError("the same files decode to other Gaussians")
    return "decodes"


@dataclass(frozen=True, slots=True)
class Outcome:
    """What became of a mutant: "decodes", a reason to refuse it, or, as a finding, any other exception."""

    number: int
    text: str
    is_finding: bool = False


def run(numbers: Iterable[int]) -> Iterator[Outcome]:
    """The outcome of each mutant; one that takes more than SECONDS is a finding."""
    signal.signal(signal.SIGALRM, _too_long)
    for number in numbers:
        signal.setitimer(signal.ITIMER_REAL, SECONDS)
        try:
            yield Outcome(number, try_mutant(number))
        except Exception as error:  # whatever it is, it is what we look for
            yield Outcome(number, f"{type(error).__name__}: {error}", True)
        finally:
            signal.setitimer(signal.ITIMER_REAL, 0)


def _too_long(signum: int, frame: FrameType | None) -> None:
    raise TimeoutError(f"more than {SECONDS:g} s")


def _work(start: int, stop: int) -> None:
    """Print the outcomes of a share as JSON lines, each with its number, so that the place of a crash is known."""
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    counts: Counter[str] = Counter()
    for outcome in run(range(start, stop)):
        counts[outcome.text] += not outcome.is_finding
        if outcome.is_finding or (outcome.number + 1) % 100 == 0:
            finding = outcome.text if outcome.is_finding else None
            print(json.dumps({"number": outcome.number, "finding": finding}), flush=True)
    print(json.dumps({"counts": counts, "peak_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024}))


@dataclass(slots=True)
class Tally:
    """What all workers found."""

    counts: Counter[str] = field(default_factory=Counter)
    findings: list[str] = field(default_factory=list)
    peak_mb: float = 0.0

    def listen(self, worker: subprocess.Popen[str]) -> None:
        """Read the lines of a worker until it ends."""
        assert worker.stdout is not None
        number = None
        for line in map(json.loads, worker.stdout):
            number = line.get("number", number)
            if line.get("finding"):
                self.findings.append(f"{number}: {line['finding']}")
            self.counts.update(line.get("counts", {}))
            self.peak_mb = max(self.peak_mb, line.get("peak_mb", 0.0))
        if worker.wait():
            self.findings.append(f"after {number}: the worker ended with {worker.returncode}")


def _share_out(first: int, count: int, jobs: int) -> list[subprocess.Popen[str]]:
    words = [sys.executable, "-m", "tests.long.fuzz", "--worker"]
    bounds = [str(first + count * i // jobs) for i in range(jobs + 1)]
    shares = itertools.pairwise(bounds)
    return [subprocess.Popen([*words, *share], stdout=subprocess.PIPE, text=True) for share in shares]


def main() -> None:
    """Share out, collect, print; exit code 1 if there is a finding."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=100_000)
    parser.add_argument("--seed", type=int, default=0, help="first number")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--worker", type=int, nargs=2, help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.worker:
        _work(*args.worker)
        return
    began, tally = time.perf_counter(), Tally()
    for worker in _share_out(args.seed, args.count, args.jobs):
        tally.listen(worker)
    print(f"{args.count} inputs in {time.perf_counter() - began:.0f} s, at most {tally.peak_mb:.0f} MB")
    for text, count in tally.counts.most_common():
        print(f"{count:9d}  {text}")
    print(f"{len(tally.findings)} findings", *tally.findings, sep="\n")
    sys.exit(bool(tally.findings))


if __name__ == "__main__":
    main()
