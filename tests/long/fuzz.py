"""Mutated files of every kind that others give us: each is read, or refused in one line that says why.

    python -m tests.long.fuzz [--count 100000] [--seed 0] [--jobs 2] [--only TARGET]

Anything else is a finding: another exception, other Gaussians than the files were made of, more than SECONDS, more than
MEMORY. The number of a finding makes it again: `--seed NUMBER --count 1`. Workers that crash or hang are replaced.
Packages are changed with their digests made anew, or not; one that is opened shows the same Gaussians as before, unless
a table, a column or a checksum was changed.
"""

from __future__ import annotations

import argparse
import faulthandler
import hashlib
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
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field, fields
from functools import cache
from pathlib import Path
from unittest.mock import patch
from zlib import crc32

import numpy as np

from airgs_codec.coding.rangecoder import Column, ColumnReader, encode_columns
from airgs_codec.jobs.job import load
from airgs_codec.media.h264 import Pictures
from airgs_codec.media.mp4 import OWN, read_segment, with_own_box
from airgs_codec.play.film import walk_through
from airgs_codec.scene.beside import read_settings
from airgs_codec.serve.pages import look_at
from airgs_codec.trainer.record import VERSION
from tests.faces import (
    JSON_NAME,
    MPD_NAME,
    NAMES,
    AirgsError,
    EncodeSettings,
    FileKind,
    FormatError,
    Memory,
    SessionSettings,
    Store,
    Trace,
    Usage,
    Work,
    check_mpd,
    decode_canonical,
    decode_segment,
    encode,
    file_kind,
    format_summary,
    load_usage,
    open_files,
    open_scene,
    open_sequence,
    read_cameras,
    read_model,
    read_region,
    read_world,
    save_usage,
    simulate,
    summarise,
    validate_files,
    write_ply,
)
from tests.support.camera_files import FORMS, as_inria
from tests.support.clip_files import numbered_4dgs, random_rows, splatv_bytes, write_spacetime_ply, write_splat4d
from tests.support.layers import NUMBERS, mutate
from tests.support.mutations import Files, honest, read_files, reindexed, write_files
from tests.support.paths import FOX, REPOSITORY, VALID
from tests.support.scenes import moving_frames, random_gaussians, write_sequence
from tests.support.splat_files import splat_bytes
from tests.support.views import ring

SECONDS = 10.0  # for a case
MEMORY = 1 << 30  # that a case may take beyond what its worker has
_ADDRESSES = 8 << 30  # of a worker in all, of which threads and libraries take much that they never use


def change_file(chance: random.Random, seed: Files) -> tuple[Files, bool]:
    name = chance.choice(list(seed))
    data = mutate(chance, seed[name], chance.choice(list(seed.values())))
    return seed | {name: mutate(chance, data, seed[name]) if chance.random() < 0.3 else data}, True


@dataclass(frozen=True, slots=True)
class Target:
    """A kind of files. `use` gives a digest of what is read, `change` tells whether that may be another."""

    name: str
    weight: float  # its share of the cases
    make: Callable[[], list[Files]]  # good files
    use: Callable[[Files], str]  # raises AirgsError where the files are refused
    change: Callable[[random.Random, Files], tuple[Files, bool]] = change_file


@cache
def seeds(target: Target) -> list[Files]:
    return target.make()


@cache
def packages() -> list[Files]:
    return [read_files(folder) for folder in sorted(VALID.iterdir())]


def decode_all(files: Files) -> str:
    """Open, check and decode a package; the digest of all Gaussians. One in four is validated, too."""
    place = Memory("mutant.airgs", files)
    is_valid = crc32(files[JSON_NAME]) % 4 == 0 and validate_files(place) == []
    digest = hashlib.sha256()
    try:
        package = open_files(place)
        m = package.manifest
        check_mpd(files[MPD_NAME], m)
        for group in range(len(m.groups)):
            bases = [decode_canonical(package, group, quality) for quality in range(len(m.qualities))]
            shown = [base.to_gaussians() for base in bases]
            for index in m.segments_of(group):
                frames = range(m.segments[index].stop - m.segments[index].start)
                for level in range(len(m.levels)):
                    shown += decode_segment(package, index, bases[0], level, frames)
            for gaussians in shown:
                for attribute in fields(gaussians):
                    digest.update(getattr(gaussians, attribute.name).tobytes())
    except AirgsError as error:
        if is_valid:
            raise AssertionError(f"what validate lets pass is refused: {error}") from error
        raise
    return digest.hexdigest()


def look_and_play(files: Files) -> str:
    """All that is told of a package, and a session over a link that is known."""
    package = open_files(Memory("mutant.airgs", files))
    m, policy = package.manifest, NAMES[crc32(files[JSON_NAME]) % len(NAMES)]
    format_summary(summarise(m, package.manifest_bytes))
    look_at(m, package.root_bytes)
    walk_through(m.region, np.zeros(1))
    assert simulate(package, Trace.open("const:1"), policy, SessionSettings(loops=2)).metrics
    return ""


@cache
def columns_of(seed: int) -> dict[str, list[Column]]:
    """The columns of each file of a package, as they are read when all of it is decoded."""
    found: dict[str, dict[ColumnReader, list[Column]]] = {}
    read = ColumnReader.column

    def column(self: ColumnReader, count: int, order: int) -> np.ndarray:
        values = read(self, count, order)
        readers = found.setdefault(self.where, {self: []})
        readers.get(self, []).append((values, order))
        return values

    with patch.object(ColumnReader, "column", column):
        decode_all(packages()[seed])
    return {where: next(iter(readers.values())) for where, readers in found.items()}


def change_package(chance: random.Random, seed: Files) -> tuple[Files, bool]:
    """One or two changes; lengths and digests are made anew from the files, from the tables up, or not at all."""
    files, columns = dict(seed), columns_of(next(i for i, p in enumerate(packages()) if p is seed))
    for _ in range(chance.choice((1, 1, 2))):
        tables = [n for n in files if file_kind(n) is FileKind.MANIFESTS and n != MPD_NAME]
        name, other = chance.choice(tables if chance.random() < 0.3 else list(files)), chance.choice(list(files))
        if chance.random() < 0.02:
            files[name], files[other] = files[other], files[name]
        elif name in columns and chance.random() < 0.25:
            with suppress(AirgsError):  # an earlier change has broken the segment
                files[name] = _with_columns(files[name], _changed(chance, columns[name]))
        else:
            files[name] = mutate(chance, files[name], files[other])
        if name.endswith(".m4s") and chance.random() < 0.5:
            files[name] = _resealed(files[name])
    changed = [name for name in seed if files[name] != seed[name]]
    tables = [n for n in changed if file_kind(n) is FileKind.MANIFESTS and n != MPD_NAME]
    anew = chance.choices((honest, reindexed, dict), (70, 15, 15))[0]
    own = [n for n in changed if n.endswith(".bin") or _own_box(files[n]) != _own_box(seed[n])]
    return anew(files), bool(tables or (anew is honest and own))


def _changed(chance: random.Random, columns: list[Column]) -> list[Column]:
    out = [(values.copy(), order) for values, order in columns]
    values = chance.choice([values for values, _ in out if len(values)])
    at = chance.randrange(len(values))
    values[at] = max(0, chance.choice((*NUMBERS, *(int(values[at]) + more for more in (-1, 1, 256)))))
    return out


def _with_columns(data: bytes, columns: list[Column]) -> bytes:
    if data[8:24] != OWN:
        return encode_columns(columns)
    return with_own_box(data[len(_own_box(data)) :], read_segment(data).checksums, encode_columns(columns))


def _own_box(data: bytes) -> bytes:
    return data[: int.from_bytes(data[:4], "big")] if data[8:24] == OWN else b""


def _resealed(data: bytes) -> bytes:
    """A media segment with the checksums of the pictures that it decodes to, if it does."""
    with suppress(AirgsError):
        segment = read_segment(data)
        found = [crc32(picture.data) for picture in Pictures(segment.samples, "")]
        checksums = (found + [0] * len(segment.samples))[: len(segment.samples)]
        return with_own_box(data[len(_own_box(data)) :], checksums, segment.columns or b"")
    return data


def read_scene(files: Files) -> str:
    """Open a file of frames and load one in its middle, of which all numbers must be finite."""
    with tempfile.TemporaryDirectory() as folder:
        sequence = open_sequence(write_files(Path(folder), files) / next(iter(files)))
        (frame,) = sequence.load([len(sequence) // 2]).frames
        assert len(frame) and all(np.isfinite(getattr(frame, f.name)).all() for f in fields(frame)), "not finite"
    return ""


def read_rig(files: Files) -> str:
    with tempfile.TemporaryDirectory() as folder:
        cameras = read_cameras(write_files(Path(folder), files))
        assert all(np.isfinite(camera.world_to_camera).all() for camera in cameras), "not finite"
        open_scene(Path(folder))
    return ""


def read_store(files: Files) -> str:
    store = Store(Memory("store", dict(files)))
    for name in files:
        load(store, name.rpartition("/")[2])
    return ""


def read_beside(files: Files) -> str:
    """Read a file that lies beside a scene or is given with it."""
    with tempfile.TemporaryDirectory() as folder:
        (name,) = files
        path = write_files(Path(folder), files) / name
        BESIDE[name](path)
    return ""


BESIDE: dict[str, Callable[[Path], object]] = {
    "trace.csv": Trace.open,
    "trace.json": Trace.open,
    "trace.txt": Trace.open,
    "region.json": read_region,
    "world.json": read_world,
    "sequence.json": lambda path: read_settings(path.parent, 10),
    "usage.npz": lambda path: load_usage(path, 0, 5, 9),
    "training.json": lambda path: read_model(path.parent),
}


def _beside() -> list[Files]:
    values = np.ones(9)
    usage = {(0, 5): Usage(values, values, np.arange(9))}
    sabre = [{"duration_ms": 1000, "bandwidth_kbps": 800, "latency_ms": 20}] * 20
    numbers = dict.fromkeys(
        ("gaussians", "added", "psnr", "held_out_psnr", "held_out_matched", "held_out_ssim", "rejected_psnr"), 1
    )
    frame = numbers | {"frame": 0, "kind": "first", "seconds": 1}
    record = {"version": VERSION, "scene": {}, "settings": {}, "total": 1, "fps": "30", "frames": [frame]}
    texts = {
        "trace.csv": (FOX / "trace.csv").read_text()[:3000],
        "trace.json": json.dumps(sabre),
        "trace.txt": "\n".join(map(str, range(0, 3000, 11))),
        "region.json": json.dumps(json.loads(packages()[0][JSON_NAME])["region"]),
        "world.json": json.dumps(np.eye(4).tolist()),
        "training.json": json.dumps(record),
        "sequence.json": (FOX / "sequence.json").read_text(),
    }
    return [_written(save_usage, "usage.npz", usage), *({name: text.encode()} for name, text in texts.items())]


def _written(make: Callable[..., object], name: str, *more: object) -> Files:
    """The files that `make` writes into a new folder, as the file of a name in it or as the folder."""
    with tempfile.TemporaryDirectory() as folder:
        make(Path(folder) / name, *more)
        return {path: data for path, data in read_files(Path(folder)).items() if name in (path, "")}


def _stored() -> Files:
    place = Memory("store")
    settings = EncodeSettings(calibrate="none", measure_pictures=0, decide_pictures=1, preset="ultrafast", threads=1)
    with tempfile.TemporaryDirectory() as folder:
        scene = open_sequence(write_sequence(Path(folder) / "scene", moving_frames(60, 3)))
        encode(scene, Path(folder) / "out.airgs", settings, work=Work(Store(place)))
    return place.files


def _scenes(*suffixes: str) -> list[Files]:
    return [{f"a{suffix}": splat_bytes(random_gaussians(40, 1), suffix)} for suffix in suffixes]


def _plys() -> list[Files]:
    plain = [_written(write_ply, "a.ply", random_gaussians(30, degree)) for degree in (0, 2)]
    return [*plain, _written(write_spacetime_ply, "a.ply", random_rows(30)), *_scenes(".compressed.ply")]


def _splatvs() -> list[Files]:
    return [{"a.splatv": splatv_bytes(random_rows(30), cameras=rig)} for rig in ((), (*as_inria(ring(3)),))]


def _numbered() -> list[Files]:
    return [{"a.4dgs": numbered_4dgs([(g, np.arange(40)) for g in moving_frames(40, 5)], 12)}]


TARGETS = (
    Target("package", 60, packages, decode_all, change_package),
    Target("tables", 10, packages, look_and_play, change_package),
    Target(".ply", 6, _plys, read_scene),
    Target(".splat", 2, lambda: _scenes(".splat"), read_scene),
    Target(".glb", 6, lambda: _scenes(".glb"), read_scene),
    Target(".splatv", 5, _splatvs, read_scene),
    Target("cameras", 8, lambda: [_written(write, "", ring(3)) for write in FORMS.values()], read_rig),
    Target("beside", 4, _beside, read_beside),
    Target("store", 2, lambda: [_stored()], read_store),
    Target(".spz", 0.5, lambda: _scenes(".v2.spz", ".v3.spz", ".v4.spz"), read_scene),
    Target(".sog", 0.5, lambda: _scenes(".sog"), read_scene),
    Target(".4dgs", 0.3, _numbered, read_scene),
    Target(".splat4d", 0.3, lambda: [_written(write_splat4d, "a.splat4d", moving_frames(40, 5), 24)], read_scene),
)


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
