"""Compiles numba's kernels before they are needed, in two processes, into numba's cache.

Compiled one after the other when they are first called, the kernels of an encode take half a minute of one core; the
compiler works on one kernel at a time in a process, so two processes halve that. `python -m airgs_codec.cli.kernels`
compiles all kernels, those of the trainer too: an installation script calls it, so that no first run has to wait.
"""

from __future__ import annotations

import inspect
import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numba.core.dispatcher import Dispatcher
from numba.core.sigutils import normalize_signature

os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")  # before numba, as in `cli.terminal`

from airgs_codec.cli.terminal import warn
from airgs_codec.coding import rangecoder
from airgs_codec.render import cpu_kernels
from airgs_codec.trainer.fit import kernels as loss_kernels

_TILES = "Tuple((f4[:,::1], i8[::1], i4[::1], i4[::1], i8, i8))"  # `Projected.tiles`
_INPUTS = "f4[:,::1], f4[:,::1], f4[:,::1], f4[::1], f4[:,:,::1]"
_SEEN = f"Tuple(({_INPUTS}, i8)), Tuple((f8[:,::1], f8[::1], i8, i8, f8, f8, f8))"  # a scene and a camera
_GRADIENT = f"{_TILES}, f4[:,:,::1], f4[:,::1], i4[::1], f4[:,:,::1], f4[:,::1]"

Kernels = tuple[tuple[Dispatcher, str], ...]

# Kernels and the types that they are called with. An encode needs the first two lists, which take about equally long.
FORWARD = (
    (cpu_kernels.project, f"({_SEEN}, b1[::1], f4[:,::1], u8[::1], i4[::1])"),
    (cpu_kernels.bin_tiles, "(f4[:,::1], i4[::1], i8[::1], b1[::1], i8, i8)"),
    (cpu_kernels.blend, f"({_TILES}, f4[::1], f4[:,:,::1], f4[:,::1], i4[::1], f4[:,::1])"),
    (cpu_kernels.blend, f"({_TILES}, f4[::1], f4[:,:,::1], f4[:,::1], i4[::1], none)"),
)
BACKWARD = (
    (cpu_kernels.blend_gradient, f"({_GRADIENT}, b1, f4[:,::1])"),
    (cpu_kernels.sum_pairs, "(i4[::1], i8[::1], i4[::1], b1[::1], f4[:,::1], f4[:,::1])"),
    (cpu_kernels.project_gradient, f"({_SEEN}, f4[:,::1], i4[::1], b1[::1], f4[:,::1], Tuple(({_INPUTS})))"),
)
TRAINING = (
    (cpu_kernels.blend_gradient, f"({_GRADIENT}, none, f4[:,::1])"),
    (loss_kernels.window_moments, "(f4[:,::1], f4[:,::1], f4[:,::1])"),
    (
        loss_kernels.l1_dssim,
        "(f4[:,::1], f4[:,::1], f4[:,::1], f4[:,::1], f8, f8, f4[:,:,::1], f4[:,:,::1], f4[:,::1], f8[:,::1])",
    ),
)


def prepare(lists: Sequence[Kernels] = (FORWARD, BACKWARD)) -> None:
    """Compile the lists side by side, a process for each, unless all of them are in numba's cache; says so on stderr.

    What fails here is compiled, or fails, when it is called.
    """
    if all(_is_cached(kernel) for kernels in lists for kernel, _ in kernels):
        return
    warn("compiling kernels, once (about 15 s on two cores)")
    rest = [subprocess.Popen([sys.executable, "-m", __spec__.name, str(n)]) for n in range(1, len(lists))]
    try:
        compile_kernels(lists[0])
    finally:
        for process in rest:
            process.wait()


def compile_kernels(kernels: Kernels) -> None:
    """Compile kernels for their types, or load them from numba's cache."""
    for kernel, types in kernels:
        kernel.compile(normalize_signature(types)[0])  # as a call does, so that calls find it in the cache
    if kernels is BACKWARD:  # it ends with what coding needs, of which these parts call each other
        coded = rangecoder.encode_columns([(np.ones(1, np.int64), 0)])
        rangecoder.ColumnReader(coded, "one number").column(1, 0)


def _is_cached(kernel: Dispatcher) -> bool:
    """Whether numba has cached the kernel since its file was written; it throws away what is older."""
    folder, source = kernel.stats.cache_path, Path(inspect.getfile(kernel.py_func))
    if folder is None:  # there is no folder that numba may write to
        return False
    written = source.stat().st_mtime
    cached = Path(folder).glob(f"{source.stem}.{kernel.py_func.__name__}-*.nbi")
    return any(path.stat().st_mtime >= written for path in cached)


if __name__ == "__main__":
    lists = (FORWARD, BACKWARD, TRAINING)
    if sys.argv[1:]:
        compile_kernels(lists[int(sys.argv[1])])
    else:
        prepare(lists)
