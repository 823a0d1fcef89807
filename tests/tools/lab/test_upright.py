"""The experiment on which way is up, on a model that the test writes: a mast on a slab that sways at its top."""

import json
import struct

import numpy as np
import pytest

from tools.lab import Lab
from tools.lab.bench import upright
from tools.lab.bench.upright import Model


def box(low, high):
    """(36, 3) corners of the 12 triangles of a box."""
    ends = np.array([low, high], np.float32)
    corners = np.array([[ends[i, 0], ends[j, 1], ends[k, 2]] for i in (0, 1) for j in (0, 1) for k in (0, 1)])
    sides = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return np.concatenate([corners[[a, b, c, a, c, d]] for a, b, c, d in sides])


@pytest.fixture
def model(tmp_path):
    """A .glb of two nodes, of which an animation turns one by a right angle about y and moves it up."""
    times = np.array([0, 1], np.float32)
    turns = np.array([[0, 0, 0, 1], [0, np.sqrt(0.5), 0, np.sqrt(0.5)]], np.float32)
    moves = np.array([[0, 0, 0], [0, 2, 0]], np.float32)
    arrays = [box([-1, 0, -1], [1, 0.1, 1]), box([-0.1, 0, -0.2], [0.1, 2, 0.2]), times, turns, moves]
    types = ["VEC3", "VEC3", "SCALAR", "VEC4", "VEC3"]
    starts = np.cumsum([0, *(array.nbytes for array in arrays)]).tolist()
    channels = [
        {"sampler": i, "target": {"node": 1, "path": path}} for i, path in enumerate(("rotation", "translation"))
    ]
    document = {
        "bufferViews": [{"byteOffset": at, "byteLength": a.nbytes} for at, a in zip(starts, arrays, strict=False)],
        "accessors": [
            {"bufferView": i, "componentType": 5126, "count": len(array), "type": kind}
            for i, (array, kind) in enumerate(zip(arrays, types, strict=True))
        ],
        "meshes": [{"primitives": [{"attributes": {"POSITION": i}}]} for i in (0, 1)],
        "nodes": [{"mesh": 0}, {"mesh": 1}],
        "scenes": [{"nodes": [0, 1]}],
        "animations": [{"samplers": [{"input": 2, "output": 3}, {"input": 2, "output": 4}], "channels": channels}],
    }
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    chunk = b"".join(array.tobytes() for array in arrays)
    size = 12 + 8 + len(text) + 8 + len(chunk)
    path = tmp_path / "mast.glb"
    path.write_bytes(
        struct.pack("<4sII", b"glTF", 2, size)
        + struct.pack("<I4s", len(text), b"JSON") + text
        + struct.pack("<I4s", len(chunk), b"BIN\0") + chunk
    )  # fmt: skip
    return path


def test_a_model_is_sampled_where_its_animation_has_moved_it(model):
    rest, half, end = (
        Model.of(model).frame(animation, moment, 2000) for animation, moment in ((None, 0), (0, 0.5), (0, 1))
    )
    mast = rest.means[:, 1] > 0.2
    assert mast.sum() > 200 and rest.means[:, 1].max() == pytest.approx(2, abs=0.05)
    np.testing.assert_allclose(half.means[mast, 1], rest.means[mast, 1] + 1, atol=1e-5)
    np.testing.assert_allclose(end.means[mast][:, [2, 0]], rest.means[mast][:, [0, 2]] * [-1, 1], atol=1e-5)


def test_a_row_says_how_often_it_was_upright(model, tmp_path):
    page = upright.run(upright.Options((str(model),), turns=2), Lab.at(tmp_path / "lab"))
    (row,) = page.sections[0].tables[0].rows
    assert row["comes"] in ("upright", "not") and row["count"] == 2
    assert all(0 <= row[how] <= 1 for how in ("quarters", "turned"))
    assert row["kind"] == "tuned" and "turned" in page.sections[0].answer
