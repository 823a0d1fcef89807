"""What the CPU renderer and gsplat on CUDA say of the same frame and cameras, and how long they take.

One row for each camera: the largest and the mean difference of pictures, the largest relative difference (L2) of the
gradients of any attribute, and the relative differences of the sums of blending weights, their maxima and their counts.
Ends with status 1 where one is over its limit, and with 2 where gsplat cannot run.
"""

from __future__ import annotations

from dataclasses import asdict, astuple, dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from airgs_codec.render.backend import CPU, Loaded, open_renderer
from airgs_codec.render.cpu import RasterInputs
from airgs_codec.scene.camera import Camera
from airgs_codec.scene.sequence import open_sequence
from tools.lab import Lab, Page, Section, Table, required, seconds_of, setting


@dataclass(frozen=True, slots=True)
class Options:
    """What is drawn."""

    sequence: Path = required("a sequence")
    views: Path = required("cameras, of which the first ones are taken")
    cameras: int = setting(4, "how many")


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
        """Return whether nothing is over its limit."""
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


def run(options: Options, lab: Lab) -> Page:
    """A row for each camera."""
    cuda = open_renderer("cuda")
    sequence = open_sequence(options.sequence, views=options.views)
    g = sequence.read(len(sequence) // 2)
    a, b = CPU.load(g), cuda.load(g)
    rows, good = [], True
    for camera in sequence.cameras[: options.cameras]:
        difference = compare(a, b, camera)
        cpu_ms, cuda_ms = (1e3 * seconds_of(lambda s=side, c=camera: s.draw(c))[0].wall for side in (a, b))  # type: ignore[misc]
        rows.append({"camera": camera.name, **asdict(difference), "cpu, ms": cpu_ms, "cuda, ms": cuda_ms})
        good &= difference.good()
    answer = "All differences are within their limits." if good else "A difference is over its limit."
    return Page([Section(answer, tables=[Table("devices", rows)])], failed=not good)
