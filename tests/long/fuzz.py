"""Mutated files of every kind that others give us: each is read, or refused in one line that says why.

Anything else is a finding: another exception, other Gaussians than the files were made of, more than SECONDS, more than
MEMORY. The number of a finding makes it again: `python -m tests.long files --seed NUMBER --times 1`. Workers that crash
or hang are replaced. Packages are changed with their digests made anew, or not; one that is opened shows the same
Gaussians as before, unless a table, a column or a checksum was changed.
"""

from __future__ import annotations

import faulthandler
import hashlib
import json
import random
import resource
import signal
import subprocess
import sys
import tempfile
import traceback
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field, fields
from functools import cache
from pathlib import Path
from unittest.mock import patch
from zlib import crc32

import numpy as np

from airgs_codec.coding.rangecoder import Column, ColumnReader, encode_columns
from airgs_codec.media import h264, mp4
from airgs_codec.serve.pages import look_at
from tests import faces
from tests.faces import AirgsError
from tests.long.faults import SETTINGS
from tests.support.camera_files import FORMS, as_inria
from tests.support.clip_files import numbered_4dgs, random_rows, splatv_bytes, write_spacetime_ply, write_splat4d
from tests.support.layers import NUMBERS, mutate
from tests.support.mutations import Files, honest, read_files, reindexed, write_files
from tests.support.paths import FOX, REPOSITORY, VALID
from tests.support.scenes import moving_frames, random_gaussians, write_sequence
from tests.support.splat_files import splat_bytes
from tests.support.views import ring

SECONDS, WAIT = 10.0, 200.0  # for a case: of CPU time, and by the clock
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
def packages() -> list[Files]:
    return [read_files(folder) for folder in sorted(VALID.iterdir())]


def decode_all(files: Files) -> str:
    """Open, check and decode a package; the digest of all Gaussians. One in four is validated, too."""
    place = faces.Memory("mutant.airgs", files)
    is_valid = crc32(files[faces.JSON_NAME]) % 4 == 0 and faces.validate_files(place) == []
    digest = hashlib.sha256()
    try:
        package = faces.open_files(place)
        m = package.manifest
        faces.check_mpd(files[faces.MPD_NAME], m)
        for group in range(len(m.groups)):
            bases = [faces.decode_canonical(package, group, quality) for quality in range(len(m.qualities))]
            shown = [base.to_gaussians() for base in bases]
            for index in m.segments_of(group):
                frames = range(m.segments[index].stop - m.segments[index].start)
                for level in range(len(m.levels)):
                    shown += faces.decode_segment(package, index, bases[0], level, frames)
            for values in (getattr(g, attribute.name) for g in shown for attribute in fields(g)):
                digest.update(values.tobytes())
    except AirgsError as error:
        if is_valid:
            raise AssertionError(f"what validate lets pass is refused: {error}") from error
        raise
    return digest.hexdigest()


def look_and_play(files: Files) -> str:
    """All that is told of a package, and a session over a link that is known."""
    package = faces.open_files(faces.Memory("mutant.airgs", files))
    m, policy = package.manifest, faces.NAMES[crc32(files[faces.JSON_NAME]) % len(faces.NAMES)]
    faces.format_summary(m, package.manifest_bytes)
    look_at(m, package.root_bytes)
    faces.walk_through(m.region, np.zeros(1))
    assert faces.simulate(package, faces.Trace.open("const:1"), policy, faces.SessionSettings(loops=2)).metrics
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
        tables = [n for n in files if faces.file_kind(n) is faces.FileKind.MANIFESTS and n != faces.MPD_NAME]
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
    tables = [n for n in changed if faces.file_kind(n) is faces.FileKind.MANIFESTS and n != faces.MPD_NAME]
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
    if data[8:24] != mp4.OWN_UUID:
        return encode_columns(columns)
    return mp4.with_own_box(data[len(_own_box(data)) :], mp4.read_segment(data).checksums, encode_columns(columns))


def _own_box(data: bytes) -> bytes:
    return data[: int.from_bytes(data[:4], "big")] if data[8:24] == mp4.OWN_UUID else b""


def _resealed(data: bytes) -> bytes:
    """A media segment with the checksums of the pictures that it decodes to, if it does."""
    with suppress(AirgsError):
        segment = mp4.read_segment(data)
        found = [crc32(picture.data) for picture in h264.Pictures(segment.samples, "")]
        checksums = (found + [0] * len(segment.samples))[: len(segment.samples)]
        return mp4.with_own_box(data[len(_own_box(data)) :], checksums, segment.columns or b"")
    return data


def read_store(files: Files) -> str:
    store = faces.Store(faces.Memory("store", dict(files)))
    for name in files:
        faces.load(store, name.rpartition("/")[2])
    return ""


def on_disk(read: Callable[[Path], object]) -> Callable[[Files], str]:
    """What writes files into a folder and reads that."""

    def use(files: Files) -> str:
        with tempfile.TemporaryDirectory() as folder:
            read(write_files(Path(folder), files))
        return ""

    return use


def read_scene(folder: Path) -> None:
    """Open a file of frames and load one in its middle, of which all numbers must be finite."""
    sequence = faces.open_sequence(next(folder.iterdir()))
    (frame,) = sequence.load([len(sequence) // 2]).frames
    assert len(frame) and all(np.isfinite(getattr(frame, f.name)).all() for f in fields(frame)), "not finite"


def read_rig(folder: Path) -> None:
    cameras = faces.read_cameras(folder)
    assert all(np.isfinite(camera.world_to_camera).all() for camera in cameras), "not finite"
    faces.open_scene(folder)


def read_beside(folder: Path) -> None:
    path = next(folder.iterdir())
    BESIDE[path.name](path)


BESIDE: dict[str, Callable[[Path], object]] = {  # files that lie beside a scene or are given with it
    **dict.fromkeys(("trace.csv", "trace.json", "trace.txt"), faces.Trace.open),
    "region.json": faces.read_region,
    "world.json": faces.read_world,
    "sequence.json": lambda path: faces.read_settings(path.parent, 10),
    "usage.npz": lambda path: faces.load_usage(path, 0, 5, 9),
    "training.json": lambda path: faces.read_model(path.parent),
}


def _beside() -> list[Files]:
    values = np.ones(9)
    usage = {(0, 5): faces.Usage(values, values, np.arange(9))}
    sabre = [{"duration_ms": 1000, "bandwidth_kbps": 800, "latency_ms": 20}] * 20
    marks = ("psnr", "held_out_psnr", "held_out_matched", "held_out_ssim", "rejected_psnr")
    frame = dict.fromkeys(("gaussians", "added", *marks), 1) | {"frame": 0, "kind": "first", "seconds": 1}
    record = {"version": faces.MODEL_VERSION, "scene": {}, "settings": {}, "total": 1, "fps": "30", "frames": [frame]}
    texts = {
        "trace.csv": (FOX / "trace.csv").read_text()[:3000],
        "trace.json": json.dumps(sabre),
        "trace.txt": "\n".join(map(str, range(0, 3000, 11))),
        "region.json": json.dumps(json.loads(packages()[0][faces.JSON_NAME])["region"]),
        "world.json": json.dumps(np.eye(4).tolist()),
        "training.json": json.dumps(record),
        "sequence.json": (FOX / "sequence.json").read_text(),
    }
    return [_written(faces.save_usage, "usage.npz", usage), *({name: text.encode()} for name, text in texts.items())]


def _written(make: Callable[..., object], name: str, *more: object) -> Files:
    """The files that `make` writes into a new folder, as the file of a name in it or as the folder."""
    with tempfile.TemporaryDirectory() as folder:
        make(Path(folder) / name, *more)
        return {path: data for path, data in read_files(Path(folder)).items() if name in (path, "")}


def _stored() -> Files:
    with tempfile.TemporaryDirectory() as folder:
        scene = faces.open_sequence(write_sequence(Path(folder) / "scene", moving_frames(60, 3)))
        faces.encode(scene, Path(folder) / "out.airgs", SETTINGS, work=Path(folder) / "work")
        return read_files(Path(folder) / "work")


def _scenes(*suffixes: str) -> list[Files]:
    return [{f"a{suffix}": splat_bytes(random_gaussians(40, 1), suffix)} for suffix in suffixes]


def _plys() -> list[Files]:
    plain = [_written(faces.write_ply, "a.ply", random_gaussians(30, degree)) for degree in (0, 2)]
    return [*plain, _written(write_spacetime_ply, "a.ply", random_rows(30)), *_scenes(".compressed.ply")]


def _splatvs() -> list[Files]:
    return [{"a.splatv": splatv_bytes(random_rows(30), cameras=rig)} for rig in ((), (*as_inria(ring(3)),))]


SCENES: dict[str, tuple[float, Callable[[], list[Files]]]] = {  # weights of targets
    ".ply": (6, _plys),
    ".splat": (2, lambda: _scenes(".splat")),
    ".glb": (6, lambda: _scenes(".glb")),
    ".splatv": (5, _splatvs),
    ".spz": (0.5, lambda: _scenes(".v2.spz", ".v3.spz", ".v4.spz")),
    ".sog": (0.5, lambda: _scenes(".sog")),
    ".4dgs": (0.3, lambda: [{"a.4dgs": numbered_4dgs([(g, np.arange(40)) for g in moving_frames(40, 5)], 12)}]),
    ".splat4d": (0.3, lambda: [_written(write_splat4d, "a.splat4d", moving_frames(40, 5), 24)]),
}
TARGETS = (
    Target("package", 60, packages, decode_all, change_package),
    Target("tables", 10, packages, look_and_play, change_package),
    Target("cameras", 8, lambda: [_written(write, "", ring(3)) for write in FORMS.values()], on_disk(read_rig)),
    Target("beside", 4, _beside, on_disk(read_beside)),
    Target("store", 2, lambda: [_stored()], read_store),
    *(Target(name, weight, make, on_disk(read_scene)) for name, (weight, make) in SCENES.items()),
)


@cache
def seeds(target: Target) -> list[Files]:
    return target.make()


@cache
def expected(target: Target, seed: int) -> str:
    return target.use(seeds(target)[seed])


def attempt(number: int) -> tuple[str, str, str]:
    """The target of a case; "read" or why it is refused; and what was found, if anything was."""
    chance = random.Random(number)
    (target,) = chance.choices(TARGETS, [t.weight for t in TARGETS])
    seed = chance.randrange(len(seeds(target)))
    files, free = target.change(chance, seeds(target)[seed])
    outcome, finding, (before, children) = "read", "", _begin()
    try:
        found = target.use(files)
    except AirgsError as error:
        found, outcome = None, error.reason if isinstance(error, faces.FormatError) else type(error).__name__
        if "\n" in str(error) or "\x1b" in str(error):
            finding = f"no plain line: {error!r}"
    except Exception as error:  # whatever it is, it is what we look for
        found, place = None, traceback.extract_tb(error.__traceback__)[-1]
        finding = f"{type(error).__name__} at {Path(place.filename).name}:{place.lineno}: {error}"
    signal.setitimer(signal.ITIMER_PROF, 0)
    faulthandler.cancel_dump_traceback_later()
    most = max(_memory("VmHWM") - before, _children() if _children() > children else 0)
    if most > MEMORY:
        finding = finding or f"{most >> 20} MB, {outcome}"
    if found is not None and not free and found != expected(target, seed):
        finding = "other Gaussians than before"
    return target.name, outcome, finding


def _begin() -> tuple[int, int]:
    """Start the clock, which ends this process, and the count of memory; bytes in use, and the peak of a child."""
    signal.setitimer(signal.ITIMER_PROF, SECONDS)
    faulthandler.dump_traceback_later(WAIT, exit=True)
    Path("/proc/self/clear_refs").write_text("5")  # the peak begins anew
    return _memory("VmRSS"), _children()


def _children() -> int:
    """Bytes of the largest process so far that read a file for this one."""
    return 1024 * resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss


def _memory(name: str) -> int:
    lines = Path("/proc/self/status").read_text().splitlines()
    return 1024 * next(int(line.split()[1]) for line in lines if line.startswith(name))


def work(start: int, stop: int) -> None:
    resource.setrlimit(resource.RLIMIT_AS, (_ADDRESSES, _ADDRESSES))
    warnings.simplefilter("ignore")
    faulthandler.register(signal.SIGPROF, chain=True)
    for number in range(start, stop):
        print(json.dumps(attempt(number)), flush=True)


@dataclass(slots=True)
class Tally:
    counts: dict[str, Counter[str]] = field(default_factory=dict)  # outcomes by target
    findings: dict[str, list[int]] = field(default_factory=dict)  # numbers of cases

    def run(self, start: int, stop: int) -> None:
        """Try cases in a process of its own, in another one after each that ends it."""
        while start < stop:
            words = [sys.executable, "-c", f"from tests.long.fuzz import work; work({start}, {stop})"]
            with tempfile.TemporaryFile("w+") as said:
                with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=said, text=True, cwd=REPOSITORY) as worker:
                    for line in worker.stdout or ():
                        name, outcome, finding = json.loads(line)
                        self.counts.setdefault(name, Counter())[outcome] += not finding
                        if finding:
                            self.findings.setdefault(f"{name}: {finding[:300]}", []).append(start)
                        start += 1
                if worker.returncode:
                    said.seek(0)
                    text = said.read()
                    place = text.partition("most recent call first")[2].split("\n")[1:4] or text.splitlines()[-1:]
                    finding = f"the worker ended with {worker.returncode}: {' '.join(place)}"
                    self.findings.setdefault(finding, []).append(start)
                    start += 1


def mutate_files(times: int, seed: int, folder: Path) -> Iterator[tuple[str, str]]:
    """So many cases from the number `seed` on, in two processes; a line for each kind of files and each finding."""
    tally, middle = Tally(), seed + times // 2
    with ThreadPoolExecutor(2) as pool:
        list(pool.map(tally.run, (seed, middle), (middle, seed + times)))
    for name, counts in tally.counts.items():
        yield f"{name}, {counts.total()}: {', '.join(f'{count} {text}' for text, count in counts.most_common())}", ""
    for finding, numbers in tally.findings.items():
        yield f"{len(numbers)} cases, as {numbers[0]}", finding
