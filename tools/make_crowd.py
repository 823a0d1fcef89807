"""Write a crowd of animated models as frames of tracked Gaussians, 30 a second, with cameras around it.

    python -m tools.make_crowd MODELS OUT [--gaussians 120000] [--seconds 2]

MODELS is a folder of .glb files with skins and animations, such as Fox and RiggedFigure of Khronos (by PixelMannen and
@tomkranis, and by Cesium; CC-BY 4.0) and Knight of KayKit (by Kay Lousberg, CC0). There is one of them for about every
10,000 Gaussians, in turn, each with a clip and a moment of its own. Gaussians are round discs at fixed places of their
triangles, as many on every square of surface, in the colours of the texture under a light of the first frame; they turn
with their triangles. T frames, V vertices, J joints, N Gaussians. Matrices take points p of a node to M p in the world.
"""

from __future__ import annotations

import argparse
import io
import json
import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation, Slerp

from airgs_codec.scene.camera import look_at
from airgs_codec.scene.formats.ply import write_ply
from airgs_codec.scene.gaussians import SH_C0, Gaussians
from tools.lab.made import camera_entry

Floats = NDArray[np.float64]
KINDS = {5121: "<u1", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
PUT_AWAY = re.compile("Offhand|Badge|Rectangle|Spike|2H_")  # nodes of weapons that nobody holds at once
LOOPS = re.compile("Survey|Walk|Run|Idle|Cheer|None")  # names of clips that end as they begin
FPS, EACH = 30, 10_000  # frames a second, Gaussians of one
HEIGHTS = {"Fox": 0.8}  # world units; of the others 1.7
APART = 0.75  # one of a crowd has the area of a circle of this radius
LIGHT = np.array([0.4, 0.8, 0.45])
SIZE, THIN, OPACITY = 0.56, 0.1, 4.0  # deviation in distances to neighbours, thickness in deviations, logit
TRAINING, HELD_OUT, PIXELS = 16, 4, 512


@dataclass(frozen=True, slots=True)
class Model:
    name: str
    document: dict[str, Any]
    chunk: bytes

    @staticmethod
    def of(path: Path) -> Model:
        data = path.read_bytes()
        end = 20 + int.from_bytes(data[12:16], "little")
        return Model(path.stem, json.loads(data[20:end]), data[end + 8 :])

    def accessor(self, index: int) -> NDArray:
        a = self.document["accessors"][index]
        view, kind, width = self.document["bufferViews"][a["bufferView"]], np.dtype(KINDS[a["componentType"]]), a["type"]
        start, size = view.get("byteOffset", 0) + a.get("byteOffset", 0), kind.itemsize * WIDTHS[width]
        strides = view.get("byteStride", size), kind.itemsize
        return np.ndarray((a["count"], WIDTHS[width]), kind, self.chunk, start, strides)

    def parts(self) -> Iterator[tuple[int, dict[str, Any]]]:
        """Yield primitives, each with the number of its node."""
        for n, node in enumerate(self.document["nodes"]):
            if "mesh" in node and not PUT_AWAY.search(node.get("name", "")):
                yield from ((n, part) for part in self.document["meshes"][node["mesh"]]["primitives"])

    def triangles(self) -> NDArray[np.int64]:
        """Return (triangles, 3) numbers of vertices, which `vertices` gives."""
        orders, before = [], 0
        for _, part in self.parts():
            count = self.document["accessors"][part["attributes"]["POSITION"]]["count"]
            order = self.accessor(part["indices"])[:, 0].astype(np.int64) if "indices" in part else np.arange(count)
            orders.append(before + order.reshape(-1, 3))
            before += count
        return np.concatenate(orders)

    def vertices(self, clip: dict[str, Any], seconds: Floats) -> Floats:
        """Return (T, V, 3) at moments (T,) of a clip, which repeats."""
        world, parts = self._worlds(clip, seconds), []
        for n, part in self.parts():
            at = {name: self.accessor(index).astype(np.float64) for name, index in part["attributes"].items()}
            points = np.column_stack([at["POSITION"], np.ones(len(at["POSITION"]))])
            if (skin := self.document["nodes"][n].get("skin")) is None:
                parts.append(np.einsum("tab,vb->tva", world[:, n], points))
                continue
            bound, inverse = (self.document["skins"][skin][key] for key in ("joints", "inverseBindMatrices"))
            bones = world[:, bound] @ self.accessor(inverse).reshape(-1, 4, 4).transpose(0, 2, 1)  # (T, J, 4, 4)
            weights = at["WEIGHTS_0"] / at["WEIGHTS_0"].sum(axis=1, keepdims=True)
            joints = zip(at["JOINTS_0"].astype(int).T, weights.T, strict=True)
            parts.append(sum(np.einsum("v,tvab,vb->tva", w, bones[:, j], points) for j, w in joints))
        return np.concatenate(parts, axis=1)[..., :3]

    def _worlds(self, clip: dict[str, Any], seconds: Floats) -> Floats:
        """Return (T, nodes, 4, 4) from nodes to the world."""
        nodes, length = self.document["nodes"], max(self.accessor(s["input"])[-1, 0] for s in clip["samplers"])
        local = np.tile([np.reshape(node.get("matrix", np.eye(4)), (4, 4)).T for node in nodes], (len(seconds), 1, 1, 1))
        moves = {(c["target"]["node"], c["target"]["path"]): clip["samplers"][c["sampler"]] for c in clip["channels"]}
        for n, node in enumerate(nodes):
            if "matrix" in node:
                continue
            found = {"rotation": [0, 0, 0, 1], "scale": [1, 1, 1], "translation": [0, 0, 0]} | node
            for path in ("rotation", "scale", "translation"):
                if sampler := moves.get((n, path)):
                    times, values = self.accessor(sampler["input"])[:, 0], self.accessor(sampler["output"])
                    when = np.clip(seconds % length, times[0], times[-1])
                    turn = path == "rotation" and len(times) > 1
                    found[path] = (
                        Slerp(times, Rotation.from_quat(values))(when).as_quat() if turn
                        else np.column_stack([np.interp(when, times, column) for column in values.T])
                    )  # fmt: skip
            turns = Rotation.from_quat(np.atleast_2d(found["rotation"])).as_matrix()
            local[:, n, :3, :3] = turns * np.atleast_2d(found["scale"])[:, None]
            local[:, n, :3, 3] = found["translation"]
        world = np.zeros_like(local)
        waiting = [(n, np.eye(4)) for n in self.document["scenes"][0]["nodes"]]
        while waiting:
            n, parent = waiting.pop()
            world[:, n] = parent @ local[:, n]
            waiting += [(child, world[:, n]) for child in nodes[n].get("children", ())]
        return world

    def colours(self, places: Floats, picked: NDArray[np.int64]) -> Floats:
        """Return (N, 3) of 0 to 1 at barycentric places (N, 3) of triangles (N,)."""
        colours, after = np.empty((len(picked), 3)), 0
        corners = self.triangles()[picked]
        for _, part in self.parts():
            surface = self.document["materials"][part["material"]]["pbrMetallicRoughness"]
            before, after = after, after + self.document["accessors"][part["attributes"]["POSITION"]]["count"]
            mine = (corners[:, 0] >= before) & (corners[:, 0] < after)
            colours[mine] = np.array(surface.get("baseColorFactor", [1, 1, 1, 1])[:3]) ** (1 / 2.2)
            if "baseColorTexture" in surface:
                image = self.document["images"][self.document["textures"][surface["baseColorTexture"]["index"]]["source"]]
                view = self.document["bufferViews"][image["bufferView"]]
                start = view.get("byteOffset", 0)
                picture = np.asarray(Image.open(io.BytesIO(self.chunk[start : start + view["byteLength"]])).convert("RGB"))
                uv = self.accessor(part["attributes"]["TEXCOORD_0"])[corners[mine] - before]
                x, y = (np.einsum("nkc,nk->cn", uv, places[mine]) % 1 * np.array(picture.shape[1::-1])[:, None]).astype(int)
                colours[mine] *= picture[y, x] / 255
        return colours


def crowd(models: list[Model], count: int, frames: int) -> Iterator[Gaussians]:
    """Yield frames of `count` Gaussians; row n is the same one in all."""
    random, corners, owners = np.random.default_rng(0), [], []
    for i in range(max(len(models), round(count / EACH))):
        model = models[i % len(models)]
        clips = [clip for clip in model.document["animations"] if LOOPS.match(str(clip.get("name")))]
        seconds = random.uniform(0, 10) + np.arange(frames) / FPS
        at = model.vertices(clips[random.integers(len(clips))], seconds)
        low, high = at[0].min(axis=0), at[0].max(axis=0)
        at = (at - (low + high) * [0.5, 0, 0.5] - low * [0, 1, 0]) * HEIGHTS.get(model.name, 1.7) / (high - low)[1]
        way, turn = i * np.pi * (3 - 5**0.5), Rotation.from_euler("y", random.uniform(0, 2 * np.pi)).as_matrix()
        at = at @ turn.T + APART * (i + 0.5) ** 0.5 * np.array([np.cos(way), 0, np.sin(way)])
        corners.append(at[:, model.triangles()].astype(np.float32))
        owners.append(model)
    first = np.concatenate([one[0] for one in corners]).astype(np.float64)
    areas = np.linalg.norm(np.cross(first[:, 1] - first[:, 0], first[:, 2] - first[:, 0]), axis=1).cumsum()
    picked = np.searchsorted(areas, (np.arange(count) + 0.5) / count * areas[-1])
    places = np.outer(np.arange(count), [0.7548776662, 0.5698402910]) % 1  # evenly spread
    places = np.where(places.sum(axis=1, keepdims=True) > 1, 1 - places, places)
    places = np.column_stack([1 - places.sum(axis=1), places])
    ends = np.cumsum([0, *(one.shape[1] for one in corners)])
    colours, sizes = np.empty((count, 3)), np.empty(count)
    points = np.einsum("nkc,nk->nc", first[picked], places)
    for start, end, model in zip(ends, ends[1:], owners, strict=False):
        mine = (picked >= start) & (picked < end)
        colours[mine] = model.colours(places[mine], picked[mine] - start)
        sizes[mine] = KDTree(points[mine]).query(points[mine], 9)[0][:, 1:].mean(axis=1)
    before = _turns(first[picked])
    upwards = before.as_matrix()[:, :, 2]
    colours *= 0.55 + 0.45 * (0.5 + 0.5 * upwards @ LIGHT / np.linalg.norm(LIGHT))[:, None]
    round_ones = Rotation.from_quat(np.column_stack([-upwards[:, 1], upwards[:, 0], np.zeros(count), 1 + upwards[:, 2]]))
    scales = np.log(SIZE * sizes)[:, None] + np.log([1, 1, THIN])
    for t in range(frames):
        now = np.concatenate([one[t] for one in corners])[picked].astype(np.float64)
        turns = (_turns(now) * before.inv() * round_ones).as_quat(scalar_first=True)
        means, logits = np.einsum("nkc,nk->nc", now, places), np.full(count, OPACITY)
        columns = means, turns, scales, logits, (colours - 0.5) / SH_C0, np.zeros((count, 0, 3))
        yield Gaussians(*(column.astype(np.float32) for column in columns))


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
    models = [Model.of(path) for path in sorted(args.models.glob("*.glb"))]
    args.out.mkdir(parents=True)
    for t, frame in enumerate(crowd(models, args.gaussians, round(FPS * args.seconds))):
        write_ply(args.out / f"{t:06d}.ply", frame)
    entries, far = [], 2.8 * np.abs(frame.means[:, [0, 2]]).max()
    for i in range(TRAINING + HELD_OUT):
        way, high = 2.399963 * i, (0.25, 0.5, 0.8)[i % 3]
        at = far * np.array([np.cos(way) * np.cos(high), np.sin(high), np.sin(way) * np.cos(high)])
        camera = look_at(at, np.array([0, 0.7, 0]), np.array([0.0, 1, 0]), size=PIXELS, fov_y=0.75, name=f"cam{i:02d}")
        entries.append(camera_entry(replace(camera, split="train" if i < TRAINING else "test"), "", 0))
    (args.out / "transforms.json").write_text(json.dumps({"frames": entries}))
    (args.out / "sequence.json").write_text(json.dumps({"fps": FPS}))


if __name__ == "__main__":
    main()
