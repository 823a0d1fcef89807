"""Mutated packages: each decodes, or is refused with a reason; never a crash, a hang, a traceback or endless memory.

    python -m tools.fuzz [--count 100000] [--seed 0] [--jobs 2]

Files of the packages under manifests/valid are mutated one or two at a time: airgs.json by its structure and by its
bytes, manifest.mpd, sidecars, escapes, init and media segments by their bytes. Most inputs have lengths and digests
mended, so that what lies behind the digests is reached; of the others, those that decode must decode to the same codes.
Every worker may use MEMORY bytes, every input SECONDS. Prints what was found, with the number that makes it again.
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
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np

from airgs_codec.decoder.decode import decode_canonical, decode_key, decode_segment, decode_state
from airgs_codec.errors import AirgsError, FormatError
from airgs_codec.package.mpd import check_mpd
from airgs_codec.package.parse import parse_manifest
from airgs_codec.package.store import Package
from airgs_codec.package.tables import JSON_NAME, MPD_NAME, FileEntry

VALID = Path(__file__).parent.parent / "manifests" / "valid"
MEMORY = 4 << 30
SECONDS = 20.0
VALUES: list[Any] = [
    None, True, -1, 0, 1, 2, 3, 7, 255, 256, 1 << 16, 1 << 24, 1 << 31, (1 << 31) - 1, 1 << 63, 10**30, -(10**12), 0.5,
    1e-30, 1e30, 1e308, -1e308, "", "x", "../../etc/passwd", "key/T0/1.bin", [], {}, [0], [[0]], [1, 2, 3], {"a": 1},
]  # fmt: skip
NUMBERS = (b"\x00\x00\x00\x00", b"\xff\xff\xff\xff", b"\x7f\xff\xff\xff", b"\x80\x00\x00\x00", b"\x00\x00\x00\x01")


@dataclass(frozen=True, slots=True, eq=False)
class Memory(Package):
    """A package that lies in memory."""

    contents: dict[str, bytes] = field(default_factory=dict)

    def _load(self, relative: str, expected: int) -> bytes:
        data = self.contents.get(relative)
        if data is None:
            raise FormatError("missing_file", relative, "expected a file, got nothing")
        if len(data) != expected:
            raise FormatError("size_mismatch", relative, f"expected {expected} bytes, got {len(data)}")
        return data


@cache
def corpus() -> list[dict[str, bytes]]:
    """Files of every valid package, by relative path."""
    return [
        {file.relative_to(folder).as_posix(): file.read_bytes() for file in sorted(folder.rglob("*")) if file.is_file()}
        for folder in sorted(VALID.iterdir())
    ]


@cache
def codes(index: int) -> bytes:
    """Digest of everything a package of the corpus decodes to."""
    return decode_all(corpus()[index])


def decode_all(files: dict[str, bytes]) -> bytes:
    """Open, check and decode a package in memory; the digest of all codes. Raises AirgsError for a bad one."""
    manifest = parse_manifest(files[JSON_NAME])
    check_mpd(files[MPD_NAME], manifest)
    package = Memory(VALID, manifest, 0, files)
    digest = hashlib.sha256()
    with np.errstate(all="ignore"):
        for group in range(len(manifest.groups)):
            base = decode_canonical(package, group, 0)
            for quality in range(len(manifest.qualities)):
                for tier in range(manifest.tier_count):
                    if manifest.groups[group].tiers[tier].number:
                        digest.update(decode_key(package, group, tier, quality)[0].tobytes())
                decode_canonical(package, group, quality)
            for index, segment in enumerate(manifest.segments):
                for level in range(len(manifest.levels) if segment.group == group else 0):
                    frames = segment.stop - segment.start
                    if manifest.state_files(index, level):
                        for code in decode_state(package, index, level, 0, frames):
                            digest.update(code.tobytes())
                    for _ in decode_segment(package, index, base, level, 0, frames):
                        pass
    return digest.digest()


def mutate_bytes(random_: random.Random, data: bytes, other: bytes) -> bytes:
    """One change: bits, bytes, numbers, pieces cut, doubled, cut short or taken from another file."""
    out = bytearray(data)
    at = random_.randrange(len(out)) if out else 0
    length = min(len(out) - at, 1 << random_.randrange(1, 7))
    kind = random_.randrange(8)
    if kind == 0:
        for _ in range(random_.choice((1, 1, 2, 8))):
            place = random_.randrange(len(out))
            out[place] ^= 1 << random_.randrange(8)
    elif kind == 1:
        out[at] = random_.randrange(256)
    elif kind == 2:
        out[at : at + 4] = random_.choice(NUMBERS)
    elif kind == 3:
        del out[at : at + length]
    elif kind == 4:
        out[at:at] = out[at : at + length]
    elif kind == 5:
        del out[at:]
    elif kind == 6:
        start = random_.randrange(len(other))
        out[at : at + length] = other[start : start + length]
    else:
        out[at:at] = random_.randbytes(length)
    return bytes(out)


def mutate_json(random_: random.Random, text: bytes) -> bytes:
    """A value somewhere in the tables replaced, dropped, doubled or moved a little."""
    data = json.loads(text)
    for _ in range(random_.choice((1, 1, 1, 2))):
        here: Any = data
        while True:
            keys = list(here) if isinstance(here, dict) else list(range(len(here)))
            if not keys:
                break
            key = random_.choice(keys)
            if isinstance(here[key], (dict, list)) and here[key] and random_.random() < 0.85:
                here = here[key]
                continue
            _change(random_, here, key)
            break
    return json.dumps(data).encode()


def _change(random_: random.Random, here: Any, key: Any) -> None:
    value, kind = here[key], random_.randrange(5)
    if kind == 0:
        del here[key]
    elif kind == 1 and isinstance(here, list):
        here.insert(key, value)
    elif kind == 2 and isinstance(value, (int, float)):
        here[key] = value + random_.choice((-1, 1, 16, 256, -value, value))
    elif kind == 3 and isinstance(value, str) and value:
        here[key] = value[:-1] + random_.choice("xA0/")
    else:
        here[key] = random_.choice(VALUES)


def mutant(number: int) -> tuple[int, dict[str, bytes], bool]:
    """(which of the corpus, its files with one or two changes, whether digests were mended) of a number."""
    random_ = random.Random(number)
    index = random_.randrange(len(corpus()))
    files = dict(corpus()[index])
    mended = random_.random() < 0.8
    for _ in range(random_.choice((1, 1, 2))):
        name = random_.choice(list(files)) if random_.random() < 0.7 else random_.choice((JSON_NAME, MPD_NAME))
        if name == JSON_NAME and random_.random() < 0.8:
            files[name] = mutate_json(random_, files[JSON_NAME]) if _is_json(files[JSON_NAME]) else files[name]
        elif files[name]:
            files[name] = mutate_bytes(random_, files[name], random_.choice([d for d in files.values() if d]))
    if mended and _is_json(files[JSON_NAME]):
        data = json.loads(files[JSON_NAME])
        if isinstance(data, dict) and isinstance(data.get("files"), dict):
            for name in data["files"]:
                if name in files and isinstance(data["files"][name], dict):
                    entry = FileEntry(len(files[name]), hashlib.sha256(files[name]).hexdigest())
                    data["files"][name] |= {"bytes": entry.bytes, "sha256": entry.sha256}
            files[JSON_NAME] = json.dumps(data).encode()
    return index, files, mended


def _is_json(text: bytes) -> bool:
    try:
        json.loads(text)
    except (ValueError, RecursionError):
        return False
    return True


def try_mutant(number: int) -> str:
    """Decode one: "decodes" or the reason it is refused for; any other exception is a finding and leaves."""
    index, files, mended = mutant(number)
    try:
        result = decode_all(files)
    except FormatError as error:
        return error.reason
    except AirgsError as error:
        return type(error).__name__
    same = all(files[name] == data for name, data in corpus()[index].items() if name not in (JSON_NAME, MPD_NAME))
    if not mended and same and files[JSON_NAME] == corpus()[index][JSON_NAME] and result != codes(index):
        raise AssertionError("the same files decode to other codes")
    return "decodes"


def _too_long(signum: int, frame: FrameType | None) -> None:
    raise TimeoutError(f"more than {SECONDS:g} s")


def run(numbers: range) -> Iterator[tuple[int, str, bool]]:
    """(number, outcome, whether it is a finding), each within SECONDS."""
    signal.signal(signal.SIGALRM, _too_long)
    for number in numbers:
        signal.setitimer(signal.ITIMER_REAL, SECONDS)
        try:
            yield number, try_mutant(number), False
        except Exception as error:  # whatever it is, it is what we look for
            yield number, f"{type(error).__name__}: {error}", True
        finally:
            signal.setitimer(signal.ITIMER_REAL, 0)


def _worker(start: int, stop: int) -> None:
    """Outcomes of a share as JSON lines; the number before each, so that a crash can be told."""
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    counts: Counter[str] = Counter()
    for number, outcome, finding in run(range(start, stop)):
        counts[outcome] += not finding
        if finding or (number + 1) % 100 == 0:
            print(json.dumps({"number": number, "finding": outcome if finding else None}), flush=True)
    print(json.dumps({"counts": counts, "peak_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024}))


def main() -> None:
    """Share out, collect, print; exit 1 if there is a finding."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=100_000)
    parser.add_argument("--seed", type=int, default=0, help="first number")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--worker", type=int, nargs=2, help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.worker:
        _worker(*args.worker)
        return
    began = time.perf_counter()
    bounds = [args.seed + args.count * i // args.jobs for i in range(args.jobs + 1)]
    workers = [
        subprocess.Popen(
            [sys.executable, "-m", "tools.fuzz", "--worker", str(a), str(b)], stdout=subprocess.PIPE, text=True
        )
        for a, b in itertools.pairwise(bounds)
    ]
    counts: Counter[str] = Counter()
    findings, peak = [], 0.0
    for worker in workers:
        assert worker.stdout is not None
        last: dict[str, Any] = {}
        for line in worker.stdout:
            last = json.loads(line)
            if last.get("finding"):
                findings.append(f"{last['number']}: {last['finding']}")
            counts.update(last.get("counts", {}))
            peak = max(peak, last.get("peak_mb", 0.0))
        if worker.wait():
            findings.append(f"after {last.get('number')}: the worker ended with {worker.returncode}")
    seconds = time.perf_counter() - began
    print(f"{args.count} inputs in {seconds:.0f} s, at most {peak:.0f} MB")
    for outcome, count in counts.most_common():
        print(f"{count:9d}  {outcome}")
    print(f"{len(findings)} findings", *findings, sep="\n")
    sys.exit(bool(findings))


if __name__ == "__main__":
    main()
