"""What the CPU renderer and gsplat on CUDA say of the same frame and cameras, and how long they take.

    python -m tools.compare_devices SEQUENCE --views CAMERAS [--cameras 4]

One row for each camera: the largest and the mean difference of pictures, the largest relative difference (L2) of the
gradients of any attribute, and the relative differences of the sums of blending weights, their maxima and their counts.
Ends with status 1 where one is over its limit, and with 2 where gsplat cannot run.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Sequence
from dataclasses import astuple, dataclass, fields
from pathlib import Path

os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

import numpy as np
from numpy.typing import NDArray

from airgs_codec.cli.common import run_command
from airgs_codec.render.backend import CPU, Loaded, open_renderer
from airgs_codec.render.inputs import RasterInputs
from airgs_codec.scene.camera import Camera
from airgs_codec.scene.sequence import open_sequence


@dataclass(frozen=True, slots=True)
class Difference:
    """How far two renderers are apart in one camera."""

    worst: float  # sample of the picture; pixels flip where alpha is next to 1/255
    mean: float
    gradients: float
    total: float
    peak: float
    hits: float

    def good(self) -> bool:
        """Whether nothing is over its limit."""
        return all(value <= limit for value, limit in zip(astuple(self), astuple(LIMITS), strict=True))


LIMITS = Difference(worst=5e-3, mean=1e-5, gradients=1e-2, total=1e-3, peak=1e-2, hits=1e-2)


def compare(a: Loaded, b: Loaded, camera: Camera) -> Difference:
    """The difference of two renderers with the same Gaussians, for a loss of random weights."""
    apart = np.abs(a.draw(camera).rgb - b.draw(camera).rgb)
    pull = np.random.default_rng(0).normal(size=apart.shape).astype(np.float32)
    (seen, by), (other, by_other) = (side.contribution_and_gradients(camera, pull) for side in (a, b))
    gradients = max(_relative(getattr(by, n), getattr(by_other, n)) for n in RasterInputs._fields)
    weights = [_relative(getattr(seen, n), getattr(other, n)) for n in ("total", "peak", "hits")]
    return Difference(float(apart.max()), float(apart.mean()), gradients, *weights)


def _relative(a: NDArray[np.generic], b: NDArray[np.generic]) -> float:
    wanted = np.asarray(a, np.float64)
    norm = float(np.linalg.norm(wanted))
    apart = float(np.linalg.norm(wanted - np.asarray(b, np.float64)))
    return apart / norm if norm else apart


def main(argv: Sequence[str] | None = None) -> int:
    """Compare and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sequence", type=Path)
    parser.add_argument("--views", type=Path, required=True)
    parser.add_argument("--cameras", type=int, default=4)
    args = parser.parse_args(argv)
    return run_command("compare_devices", lambda: _run(args))


def _run(args: argparse.Namespace) -> int:
    cuda = open_renderer("cuda")
    sequence = open_sequence(args.sequence, views=args.views)
    g = sequence.read(len(sequence) // 2)
    a, b = CPU.load(g), cuda.load(g)
    good = True
    print(" ".join(f"{name:>10}" for name in ["camera", *(f.name for f in fields(Difference)), "cpu ms", "cuda ms"]))
    for camera in sequence.cameras[: args.cameras]:
        difference = compare(a, b, camera)
        times = [1e3 * _seconds(side, camera) for side in (a, b)]
        print(f"{camera.name:>10} " + " ".join(f"{v:>10.2e}" for v in [*astuple(difference), *times]), flush=True)
        good &= difference.good()
    return 0 if good else 1


def _seconds(side: Loaded, camera: Camera) -> float:
    """Of drawing a picture and bringing it to the program."""
    begun = time.perf_counter()
    side.draw(camera)
    return time.perf_counter() - begun


if __name__ == "__main__":
    raise SystemExit(main())
