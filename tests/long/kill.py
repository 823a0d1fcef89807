"""Kill encodes and training runs at random moments: what is there stays whole, and a restart finishes.

    python -m tests.long.kill [--encodes 25] [--trainings 25] [--seed 0]

Encodes of the embedded scene write over an existing package: after every kill -9 the target is a valid package, the old
one or the new one. Training runs of the embedded views are killed and resumed until they end: their frames and record
must equal those of an unbroken run. Prints a line a kill; exit 1 if something was lost.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from airgs_codec.inspect.validate import validate
from tests.support.paths import FOX, FOX_VIEWS

ENCODE = ["airgs_codec.cli.encode", str(FOX), "--x264-preset", "ultrafast", "--calibrate", "none", "--json"]
TRAIN = ["airgs_codec.cli.train", str(FOX_VIEWS), "--iterations", "120,60,30", "--budget", "1500", "--json"]


def command(words: list[str]) -> subprocess.Popen[bytes]:
    code = f"import sys; from {words[0]} import main; sys.exit(main(sys.argv[1:]))"
    return subprocess.Popen([sys.executable, "-c", code, *words[1:]], stdout=subprocess.DEVNULL)


def seconds_of(words: list[str]) -> float:
    began = time.perf_counter()
    if command(words).wait():
        raise SystemExit(f"{' '.join(words)}: failed without a kill")
    return time.perf_counter() - began


def killed(words: list[str], after_s: float) -> bool:
    process = command(words)
    try:
        process.wait(after_s)
        return False
    except subprocess.TimeoutExpired:
        process.send_signal(signal.SIGKILL)
        process.wait()
        return True


def kill_encodes(count: int, chance: random.Random, folder: Path) -> int:
    """How many kills left something that is not a whole package."""
    target = folder / "fox.airgs"
    words = [*ENCODE, "-o", str(target)]
    whole = seconds_of(words)
    bad = 0
    for number in range(count):
        after = chance.uniform(0.1, 1.05 * whole)
        ended = "killed" if killed(words, after) else "finished"
        findings = validate(target)
        bad += bool(findings)
        print(f"encode {number + 1}: {ended} after {after:.2f} s, {findings or 'the target is whole'}", flush=True)
    fresh = folder / "fresh.airgs"
    for after in (0.3 * whole, 0.9 * whole):
        killed([*ENCODE, "-o", str(fresh)], after)
        bad += fresh.exists() and bool(validate(fresh))
    seconds_of([*ENCODE, "-o", str(fresh)])
    return bad + bool(validate(fresh))


def digest(model: Path) -> dict[str, str]:
    """Of everything a training run ends with; its record without the seconds."""
    record = json.loads((model / "training.json").read_text())
    for frame in record["frames"]:
        frame["seconds"] = 0
    out = {"training.json": json.dumps(record)}
    for file in sorted(model.iterdir()):
        if file.suffix == ".ply":
            out[file.name] = hashlib.sha256(file.read_bytes()).hexdigest()
    return out


def kill_trainings(count: int, chance: random.Random, folder: Path) -> int:
    """How many of the runs, killed and resumed, ended otherwise than the unbroken one."""
    whole = seconds_of([*TRAIN, "-o", str(folder / "unbroken")])
    expected = digest(folder / "unbroken")
    bad, kills, run = 0, 0, 0
    while kills < count:
        run += 1
        model = folder / f"run{run}"
        while True:
            after = chance.uniform(0.1, 0.8 * whole)
            if not killed([*TRAIN, "-o", str(model), "--resume"], after):
                break
            kills += 1
            frames = len(list(model.glob("*.ply"))) if model.exists() else 0
            print(f"training {kills}: killed after {after:.2f} s, {frames} frames kept", flush=True)
        same = digest(model) == expected
        bad += not same
        print(f"run {run}: {'the same end' if same else 'ANOTHER END'}", flush=True)
    return bad


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--encodes", type=int, default=25)
    parser.add_argument("--trainings", type=int, default=25)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    chance = random.Random(args.seed)
    with tempfile.TemporaryDirectory() as folder:
        os.environ["XDG_CACHE_HOME"] = folder
        bad = kill_encodes(args.encodes, chance, Path(folder)) + kill_trainings(args.trainings, chance, Path(folder))
    print(f"{bad} findings")
    sys.exit(bool(bad))


if __name__ == "__main__":
    main()
