"""A crowd of animated models as frames of tracked Gaussians, 30 a second.

Models are .glb files with skins and animations, such as Fox (PixelMannen, CC0; rig by @tomkranis, CC-BY 4.0) and
RiggedFigure (Cesium, CC-BY 4.0) of Khronos, and Knight of KayKit (Kay Lousberg, CC0). There is one of them for every
10,000 Gaussians, in turn, each with a clip and a moment of its own. Gaussians are round discs at fixed places of
triangles, as many on every part of the surface, in the colours of the first picture under the light of the first frame.
T frames, V vertices, F triangles, J joints, N Gaussians. Matrices take points of a node to the world.
"""

from __future__ import annotations

import io
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy.interpolate import make_interp_spline
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation, Slerp

from airgs_codec.scene.formats.gltf import local_matrix, open_gltf, read_accessor
from airgs_codec.scene.gaussians import SH_C0, Gaussians

Floats = NDArray[np.float64]
PUT_AWAY = re.compile("Offhand|Badge|Rectangle|Spike|2H_")  # nodes of what nobody holds at once
LOOPS = re.compile("Survey|Walk|Run|Idle|Cheer|None")  # names of clips that end as they begin
HEIGHTS = {"Fox": 0.8}  # world units; of the others 1.7
FPS, EACH, APART = 30, 10_000, 0.75  # frames a second, Gaussians of one, the radius of the circle that it has
LIGHT = np.array([0.4, 0.8, 0.45])  # of length 1
SIZE, THIN, OPACITY = 0.56, 0.1, 4.0  # deviation in distances to neighbours, thickness in deviations, logit


class Model:
    """A .glb: `faces` (F, 3) are numbers of vertices, `uv` (V, 2) places of `picture` (height, width, 3) of 0 to 1."""

    def __init__(self, path: Path) -> None:
        self.name, (self.document, self.chunk) = path.stem, open_gltf(path)
        self.parts, faces, uv, count = [], list[NDArray](), list[NDArray](), 0
        for n, node in enumerate(self.document["nodes"]):
            shown = "mesh" in node and not PUT_AWAY.search(node.get("name", ""))
            for part in self.document["meshes"][node["mesh"]]["primitives"] if shown else ():
                self.parts.append((n, part))
                names, corners = part["attributes"], part.get("indices")
                rows = self.document["accessors"][names["POSITION"]]["count"]
                uv.append(self.read(names["TEXCOORD_0"], 2) if "TEXCOORD_0" in names else np.zeros((rows, 2)))
                faces.append(count + (np.arange(rows) if corners is None else self.read(corners, 1).astype(int)))
                count += rows
        self.faces, self.uv = np.concatenate([one.reshape(-1, 3) for one in faces]), np.concatenate(uv)
        if "images" in self.document:
            view = self.document["bufferViews"][self.document["images"][0]["bufferView"]]
            start = view.get("byteOffset", 0)
            with Image.open(io.BytesIO(self.chunk[start : start + view["byteLength"]])) as image:
                self.picture = np.asarray(image.convert("RGB")) / 255
        else:
            base = self.document["materials"][0]["pbrMetallicRoughness"]["baseColorFactor"]  # linear
            self.picture = np.array([[base[:3]]]) ** (1 / 2.2)

    def read(self, accessor: int, width: int) -> Floats:
        return read_accessor(self.document, [self.chunk], accessor, width).astype(np.float64)

    def vertices(self, clip: dict[str, Any], seconds: Floats) -> Floats:
        """Return (T, V, 3) at moments (T,) of a clip, which repeats."""
        world, posed = self._worlds(clip, seconds), []
        for n, part in self.parts:
            names, skin = part["attributes"], self.document["nodes"][n].get("skin")
            points = np.insert(self.read(names["POSITION"], 3), 3, 1, axis=1)
            if skin is None:
                posed.append(np.einsum("tab,vb->tva", world[:, n], points))
                continue
            bound, inverse = (self.document["skins"][skin][key] for key in ("joints", "inverseBindMatrices"))
            bones = world[:, bound] @ self.read(inverse, 16).reshape(-1, 4, 4).transpose(0, 2, 1)  # (T, J, 4, 4)
            joints, shares = self.read(names["JOINTS_0"], 4).astype(int), self.read(names["WEIGHTS_0"], 4)
            pairs = zip(joints.T, shares.T / shares.sum(axis=1), strict=True)
            posed.append(sum(np.einsum("v,tvab,vb->tva", share, bones[:, joint], points) for joint, share in pairs))
        return np.concatenate(posed, axis=1)[..., :3]

    def _worlds(self, clip: dict[str, Any], seconds: Floats) -> Floats:
        """Return (T, nodes, 4, 4)."""
        nodes, samplers = [dict(node) for node in self.document["nodes"]], clip["samplers"]
        length, moves = max(self.read(s["input"], 1)[-1, 0] for s in samplers), []
        for channel in clip["channels"]:
            sampler, (node, path) = samplers[channel["sampler"]], (channel["target"][key] for key in ("node", "path"))
            times, turns = self.read(sampler["input"], 1)[:, 0], path == "rotation"
            values = self.read(sampler["output"], 4 if turns else 3)
            between = Slerp(times, Rotation.from_quat(values)) if turns else make_interp_spline(times, values, 1)
            found = between(np.clip(seconds % length, times[0], times[-1]))
            moves.append((nodes[node], path, found.as_quat() if turns else found))
        local = np.empty((len(seconds), len(nodes), 4, 4))
        for t in range(len(seconds)):
            for node, path, values in moves:
                node[path] = values[t]
            local[t] = [local_matrix(node) for node in nodes]
        world, waiting = local.copy(), [(n, -1) for n in self.document["scenes"][0]["nodes"]]
        for n, parent in waiting:  # which grows
            world[:, n] = local[:, n] if parent < 0 else world[:, parent] @ local[:, n]
            waiting += [(child, n) for child in nodes[n].get("children", ())]
        return world


def crowd(models: list[Model], count: int, frames: int) -> Iterator[Gaussians]:
    """Yield frames of `count` Gaussians; row n is the same one in all."""
    random, corners = np.random.default_rng(0), list[NDArray]()
    owners = [models[i % len(models)] for i in range(max(1, count // EACH))]
    for i, model in enumerate(owners):
        clips = [clip for clip in model.document["animations"] if LOOPS.match(str(clip.get("name")))]
        at = model.vertices(clips[random.integers(len(clips))], random.uniform(0, 10) + np.arange(frames) / FPS)
        low, high = at[0].min(axis=0), at[0].max(axis=0)
        at = (at - [(low + high)[0] / 2, low[1], (low + high)[2] / 2]) * HEIGHTS.get(model.name, 1.7) / (high - low)[1]
        way, turn = i * np.pi * (3 - 5**0.5), Rotation.from_euler("y", random.uniform(0, 2 * np.pi))
        at = at @ turn.as_matrix().T + APART * (i + 0.5) ** 0.5 * np.array([np.cos(way), 0, np.sin(way)])
        corners.append(at[:, model.faces].astype(np.float32))
    first = np.concatenate([one[0] for one in corners]).astype(np.float64)
    areas = np.linalg.norm(np.cross(first[:, 1] - first[:, 0], first[:, 2] - first[:, 0]), axis=1).cumsum()
    picked = np.searchsorted(areas, (np.arange(count) + 0.5) / count * areas[-1])
    places = np.outer(np.arange(count), [0.7548776662, 0.5698402910]) % 1  # evenly spread over squares, then triangles
    places = np.where(places.sum(axis=1, keepdims=True) > 1, 1 - places, places)
    places = np.insert(places, 0, 1 - places.sum(axis=1), axis=1)
    points, start = np.einsum("nkc,nk->nc", first[picked], places), 0
    colours, sizes = np.empty((count, 3)), np.empty((count, 1))
    for model in owners:
        mine = (picked >= start) & (picked < start + len(model.faces))
        uv = np.einsum("nkc,nk->cn", model.uv[model.faces[picked[mine] - start]], places[mine]) % 1
        x, y = (uv * np.array(model.picture.shape[1::-1])[:, None]).astype(int)
        colours[mine] = model.picture[y, x]
        sizes[mine] = SIZE * KDTree(points[mine]).query(points[mine], 9)[0][:, 1:].mean(axis=1, keepdims=True)
        start += len(model.faces)
    before = _turns(first[picked])
    x, y, z = before.as_matrix()[:, :, 2].T
    colours *= 0.775 + 0.225 * np.stack([x, y, z], axis=1) @ LIGHT[:, None]
    upright = Rotation.from_quat(np.stack([-y, x, 0 * x, 1 + z], axis=1))  # turned the least
    still = np.log(sizes * [1, 1, THIN]), np.full(count, OPACITY), (colours - 0.5) / SH_C0, np.zeros((count, 0, 3))
    for t in range(frames):
        now = np.concatenate([one[t] for one in corners])[picked].astype(np.float64)
        turns = (_turns(now) * before.inv() * upright).as_quat(scalar_first=True)
        yield Gaussians(*(c.astype(np.float32) for c in (np.einsum("nkc,nk->nc", now, places), turns, *still)))


def _turns(corners: Floats) -> Rotation:
    """Return how triangles (N, 3, 3) lie: x along their first edge, z away from their surface."""
    x = corners[:, 1] - corners[:, 0]
    z = np.cross(x, corners[:, 2] - corners[:, 0])
    x, z = (v / np.linalg.norm(v, axis=1, keepdims=True) for v in (x, z))
    return Rotation.from_matrix(np.stack([x, np.cross(z, x), z], axis=2))
