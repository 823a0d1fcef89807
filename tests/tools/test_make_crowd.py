"""A crowd of one triangle that turns about a joint: where its Gaussians are and how they turn, and their colours."""

import io
import json
import struct

import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation

from tools.make_crowd import Model, crowd


def turning_triangle():
    """A .glb of a triangle with a skin, red but for a corner that is blue, which turns once about y in four seconds."""
    picture, sides, angle = io.BytesIO(), np.arange(5), np.arange(5) * np.pi / 4
    Image.fromarray(np.array([[[255, 0, 0], [0, 0, 255]]], np.uint8)).save(picture, "png")
    turns = np.stack([0 * angle, np.sin(angle), 0 * angle, np.cos(angle)], axis=1)
    corners, uv, joints = [[0, 0, 0], [1, 0, 0], [0, 2, 0]], [[0, 0], [0.9, 0], [0, 0]], [[0, 0, 0, 0]] * 3
    columns = [corners, uv, joints, [[1, 0, 0, 0]] * 3, np.eye(4).reshape(1, 16), sides[:, None], turns]
    data = [np.asarray(column, "<f4").tobytes() for column in columns] + [picture.getvalue()]
    starts, names = np.cumsum([0, *map(len, data)]).tolist(), ("POSITION", "TEXCOORD_0", "JOINTS_0", "WEIGHTS_0")
    kinds = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}
    channel = {"sampler": 0, "target": {"node": 1, "path": "rotation"}}
    document = {
        "scenes": [{"nodes": [0, 1]}], "nodes": [{"mesh": 0, "skin": 0}, {"translation": [1, 0, 0]}],
        "meshes": [{"primitives": [{"attributes": dict(zip(names, range(4), strict=True))}]}],
        "skins": [{"joints": [1], "inverseBindMatrices": 4}], "images": [{"bufferView": 7}],
        "accessors": [{"bufferView": i, "count": len(column), "type": kinds[np.shape(column)[1]], "componentType": 5126}
                      for i, column in enumerate(columns)],
        "bufferViews": [{"buffer": 0, "byteOffset": starts[i], "byteLength": len(one)} for i, one in enumerate(data)],
        "animations": [{"name": "Walk", "samplers": [{"input": 5, "output": 6}], "channels": [channel]}],
    }  # fmt: skip
    text = json.dumps(document).encode()
    head = struct.pack("<4sIII4s", b"glTF", 2, 28 + len(text) + starts[-1], len(text), b"JSON")
    return head + text + struct.pack("<I4s", starts[-1], b"BIN\0") + b"".join(data)


def test_gaussians_of_a_crowd_stay_at_their_places_of_triangles_and_turn_with_them(tmp_path):
    (tmp_path / "one.glb").write_bytes(turning_triangle())
    first, *_, last = crowd([Model(tmp_path / "one.glb")], 400, 6)
    apart, turn = [g.means - g.means.mean(axis=0) for g in (first, last)], Rotation.from_rotvec([0, np.pi / 12, 0])
    np.testing.assert_allclose(turn.apply(apart[0]), apart[1], atol=1e-5)
    before, after = (Rotation.from_quat(g.quaternions, scalar_first=True) for g in (first, last))
    assert (turn * before * after.inv()).magnitude().max() < 1e-5
    assert np.abs(np.einsum("nk,nk->n", after.apply([0, 0, 1]), apart[1])).max() < 1e-5  # flat on the triangle
    assert np.ptp(first.means[:, 1]) == pytest.approx(1.7, rel=0.1)
    red, _, blue = (first.sh_dc > -1.7).T
    assert (red ^ blue).all() and blue.mean() == pytest.approx((1 - 0.5 / 0.9) ** 2, abs=0.02)
