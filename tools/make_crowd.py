"""Write a crowd of animated models as frames of tracked Gaussians, 30 a second, with cameras around it.

    python -m tools.make_crowd MODELS OUT [--gaussians 120000] [--seconds 2]

MODELS is a folder of .glb files with skins and animations, such as Fox (PixelMannen, @tomkranis) and RiggedFigure
(Cesium) of Khronos, CC-BY 4.0, and Knight of KayKit (Kay Lousberg, CC0). There is one of them for every 10,000
Gaussians, in turn, each with a clip and a moment of its own. Gaussians are round discs at fixed places of triangles, as
many on every part of the surface, in the colours of the first picture under the light of the first frame. T frames, V
vertices, F triangles, J joints, N Gaussians. Matrices take points of a node to the world.
"""

from __future__ import annotations

import argparse
import io
import json
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy.interpolate import make_interp_spline
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation, Slerp

from airgs_codec.scene.camera import dome_views
from airgs_codec.scene.formats.ply import write_ply
from airgs_codec.scene.gaussians import SH_C0, Gaussians
from tools.lab.made import camera_entry

Floats = NDArray[np.float64]
KINDS = {5121: "<u1", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
REST = {"rotation": [0, 0, 0, 1], "scale": [1, 1, 1], "translation": [0, 0, 0]}
PUT_AWAY = re.compile("Offhand|Badge|Rectangle|Spike|2H_")  # nodes of what nobody holds at once
LOOPS = re.compile("Survey|Walk|Run|Idle|Cheer|None")  # names of clips that end as they begin
FPS, EACH = 30, 10_000  # frames a second, Gaussians of one
HEIGHTS = {"Fox": 0.8}  # world units; of the others 1.7
APART = 0.75  # one of a crowd has the area of a circle of this radius
LIGHT = np.array([0.4, 0.8, 0.45])  # of length 1
SIZE, THIN, OPACITY = 0.56, 0.1, 4.0  # deviation in distances to neighbours, thickness in deviations, logit
CAMERAS, PIXELS, RISES = 20, 512, (0.15, 0.9)  # of which every fifth is held out; radians above the horizon


class Model:
    """A .glb: `faces` (F, 3) are numbers of vertices, `uv` (V, 2) places of `picture` (height, width, 3) of 0 to 1."""

    def __init__(self, path: Path) -> None:
        data = path.read_bytes()
        end = 20 + int.from_bytes(data[12:16], "little")
        self.name, self.document, self.chunk = path.stem, json.loads(data[20:end]), data[end + 8 :]
        self.parts, faces, uv, count = [], list[NDArray](), list[NDArray](), 0
        for n, node in enumerate(self.document["nodes"]):
            shown = "mesh" in node and not PUT_AWAY.search(node.get("name", ""))
            for part in self.document["meshes"][node["mesh"]]["primitives"] if shown else ():
                self.parts.append((n, part))
                at = {name: self.accessor(index) for name, index in part["attributes"].items()}
                uv.append(at.get("TEXCOORD_0", np.zeros((len(at["POSITION"]), 2))))
                faces.append(count + (self.accessor(part["indices"]) if "indices" in part else np.arange(len(uv[-1]))))
                count += len(uv[-1])
        self.faces, self.uv = np.concatenate([one.reshape(-1, 3) for one in faces]), np.concatenate(uv)
        if "images" in self.document:
            view = self.document["bufferViews"][self.document["images"][0]["bufferView"]]
            start = view.get("byteOffset", 0)
            with Image.open(io.BytesIO(self.chunk[start : start + view["byteLength"]])) as image:
                self.picture = np.asarray(image.convert("RGB")) / 255
        else:
            base = self.document["materials"][0]["pbrMetallicRoughness"]["baseColorFactor"]
            self.picture = np.array(base[:3]).reshape(1, 1, 3) ** (1 / 2.2)

    def accessor(self, index: int) -> NDArray:
        a = self.document["accessors"][index]
        view, kind = self.document["bufferViews"][a["bufferView"]], np.dtype(KINDS[a["componentType"]])
        width, start = WIDTHS[a["type"]], view.get("byteOffset", 0) + a.get("byteOffset", 0)
        stride = view.get("byteStride", kind.itemsize * width)
        return np.ndarray((a["count"], width), kind, self.chunk, start, (stride, kind.itemsize))

    def vertices(self, clip: dict[str, Any], seconds: Floats) -> Floats:
        """Return (T, V, 3) at moments (T,) of a clip, which repeats."""
        world, posed = self._worlds(clip, seconds), []
        for n, part in self.parts:
            at = {name: self.accessor(index).astype(np.float64) for name, index in part["attributes"].items()}
            points, skin = np.insert(at["POSITION"], 3, 1, axis=1), self.document["nodes"][n].get("skin")
            if skin is None:
                posed.append(np.einsum("tab,vb->tva", world[:, n], points))
                continue
            bound, inverse = (self.document["skins"][skin][key] for key in ("joints", "inverseBindMatrices"))
            bones = world[:, bound] @ self.accessor(inverse).reshape(-1, 4, 4).transpose(0, 2, 1)  # (T, J, 4, 4)
            pairs = zip(at["JOINTS_0"].astype(int).T, at["WEIGHTS_0"].T / at["WEIGHTS_0"].sum(axis=1), strict=True)
            posed.append(sum(np.einsum("v,tvab,vb->tva", share, bones[:, joint], points) for joint, share in pairs))
        return np.concatenate(posed, axis=1)[..., :3]

    def _worlds(self, clip: dict[str, Any], seconds: Floats) -> Floats:
        """Return (T, nodes, 4, 4)."""
        nodes, length = self.document["nodes"], max(self.accessor(s["input"])[-1, 0] for s in clip["samplers"])
        matrices = [np.reshape(node.get("matrix", np.eye(4)), (4, 4)).T for node in nodes]
        local = np.tile(matrices, (len(seconds), 1, 1, 1))
        found = [{name: np.atleast_2d(node.get(name, rest)) for name, rest in REST.items()} for node in nodes]
        for channel in clip["channels"]:
            sampler, target = clip["samplers"][channel["sampler"]], channel["target"]
            times, values = self.accessor(sampler["input"])[:, 0], self.accessor(sampler["output"])
            when = np.clip(seconds % length, times[0], times[-1])
            turns = target["path"] == "rotation"
            if len(times) > 1:
                between = Slerp(times, Rotation.from_quat(values)) if turns else make_interp_spline(times, values, 1)
                values = between(when).as_quat() if turns else between(when)
            found[target["node"]][target["path"]] = values
        for n, parts in enumerate(found):
            if "matrix" not in nodes[n]:
                local[:, n, :3, :3] = Rotation.from_quat(parts["rotation"]).as_matrix() * parts["scale"][:, None]
                local[:, n, :3, 3] = parts["translation"]
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


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("models", type=Path, metavar="MODELS")
    parser.add_argument("out", type=Path, metavar="OUT")
    parser.add_argument("--gaussians", type=int, default=120_000, metavar="N")
    parser.add_argument("--seconds", type=float, default=2.0, metavar="S")
    args = parser.parse_args()
    args.out.mkdir(parents=True)
    models = [Model(path) for path in sorted(args.models.glob("*.glb"))]
    for t, frame in enumerate(crowd(models, args.gaussians, round(FPS * args.seconds))):
        write_ply(args.out / f"{t:06d}.ply", frame)
    views = enumerate(dome_views(frame, CAMERAS, PIXELS, np.array([0.0, 1, 0]), RISES))
    entries = [camera_entry(replace(view, split="train" if i % 5 else "test"), "", 0) for i, view in views]
    (args.out / "transforms.json").write_text(json.dumps({"fps": FPS, "frames": entries}))


if __name__ == "__main__":
    main()
