"""Kernels are compiled for the types that they are called with, or compiling them ahead would be work for nothing."""

import numpy as np
from numba.core.sigutils import normalize_signature

from airgs_codec.cli.kernels import BACKWARD, FORWARD
from airgs_codec.render import cpu
from tests.faces import decode_frames, open_package, orbit_views
from tests.support.paths import GOLDEN
from tests.support.views import coloured_cloud


def test_encoding_and_decoding_call_kernels_with_the_types_they_are_compiled_for():
    g = coloured_cloud(40)
    (camera,) = orbit_views(g, count=1, size=32)
    cpu.measure_contribution(g, camera)
    cpu.contribution_and_gradients(cpu.activate(g), camera, np.ones((32, 32, 3), np.float32))
    assert len(list(decode_frames(open_package(GOLDEN / "fox"), 0, 2))) == 2
    unused = [(k.py_func.__name__, t) for k, t in FORWARD + BACKWARD if normalize_signature(t)[0] not in k.signatures]
    assert [name for name, _ in unused if name != "read_planes"] == []
    assert len(unused) <= 2  # of read_planes, whose types depend on the pages of a picture
