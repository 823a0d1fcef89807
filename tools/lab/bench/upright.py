"""How often viewers begin upright where nobody tells which way is up: scenes as they come, and turned at random.

A scene is SCENE=UP, with what is up in it; in a .glb that is y. Each is turned by one after another of the 24 turns
that map axes to axes, and tilted at random; and as often by turns of which each is as likely as any other. Of a model
another animation is shown every time, but for those in which it lies down. A first view is upright where up is within
25 degrees of that of the picture. "held back" are those by whom no weight was chosen.

A model is discs on the triangles of a .glb file, at a moment of one of its animations. V vertices, J joints, N
Gaussians. Matrices are those of glTF: a point p of a node is at M p in the world.
"""

from __future__ import annotations

import io
import json
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import repeat
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy.spatial.transform import Rotation, Slerp

from airgs_codec._sampling import evenly_spaced
from airgs_codec.analysis.viewpoints import find_viewpoints
from airgs_codec.package.region import parse_up
from airgs_codec.scene.frames import repair
from airgs_codec.scene.gaussians import SH_C0, Gaussians, multiply
from airgs_codec.scene.sequence import open_sequence
from tools.lab import Lab, Page, Row, Section, Table, required, setting

Floats = NDArray[np.float64]

KINDS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
TRIANGLES = 4
OPACITY = 4.0  # logit
THIN = 0.05  # thickness of a disc, in radii


@dataclass(frozen=True, slots=True, eq=False)
class Triangles:
    corners: Floats  # (V, 3, 3) world units
    colours: Floats  # (V, 3, 3) of the corners, 0..1


@dataclass(slots=True, eq=False)
class Model:
    document: dict[str, Any]
    chunk: bytes
    pictures: dict[int, Floats] = field(default_factory=dict)

    @staticmethod
    def of(path: Path) -> Model:
        data = path.read_bytes()
        end = 20 + int.from_bytes(data[12:16], "little")
        return Model(json.loads(data[20:end]), data[end + 8 :])

    def frame(self, animation: int | None, moment: float, count: int, seed: int = 0) -> Gaussians:
        """`count` Gaussians at a moment from 0 to 1 of an animation; None: at rest. A seed gives the same rows."""
        t, rng = self._triangles(self._matrices(animation, moment)), np.random.default_rng(seed)
        across = np.cross(t.corners[:, 1] - t.corners[:, 0], t.corners[:, 2] - t.corners[:, 0])
        areas = np.linalg.norm(across, axis=1) / 2
        picked = rng.choice(len(areas), count, p=areas / areas.sum())
        weights = rng.dirichlet(np.ones(3), count)[:, :, None]
        normals = across[picked] / (2 * areas[picked, None])
        radius = np.log(np.sqrt(areas.sum() / count / np.pi))
        colours = (t.colours[picked] * weights).sum(axis=1)
        return Gaussians(
            (t.corners[picked] * weights).sum(axis=1).astype(np.float32),
            _standing(normals).astype(np.float32),
            np.tile(radius + np.array([0, 0, np.log(THIN)]), (count, 1)).astype(np.float32),
            np.full(count, OPACITY, np.float32),
            ((colours - 0.5) / SH_C0).astype(np.float32),
            np.zeros((count, 0, 3), np.float32),
        )

    def accessor(self, index: int) -> NDArray:
        a = self.document["accessors"][index]
        view, kind, width = self.document["bufferViews"][a["bufferView"]], KINDS[a["componentType"]], WIDTHS[a["type"]]
        start, item = view.get("byteOffset", 0) + a.get("byteOffset", 0), np.dtype(kind).itemsize * width
        stride, count = view.get("byteStride", item), a["count"]
        raw = np.frombuffer(self.chunk, np.uint8, stride * (count - 1) + item, start)
        rows = np.lib.stride_tricks.as_strided(raw, (count, item), (stride, 1))
        values = np.ascontiguousarray(rows).view(kind).reshape(count, width)
        return values / np.iinfo(kind).max if a.get("normalized") else values

    def _matrices(self, animation: int | None, moment: float) -> Floats:
        """(nodes, 4, 4) from nodes to the world."""
        nodes = [dict(node) for node in self.document["nodes"]]
        if animation is not None:
            self._move(nodes, self.document["animations"][animation], moment)
        world = np.tile(np.eye(4), (len(nodes), 1, 1))
        roots = [(n, np.eye(4)) for n in self.document["scenes"][self.document.get("scene", 0)]["nodes"]]
        while roots:
            n, parent = roots.pop()
            world[n] = parent @ _local(nodes[n])
            roots += [(child, world[n]) for child in nodes[n].get("children", ())]
        return world

    def _move(self, nodes: list[dict[str, Any]], animation: dict[str, Any], moment: float) -> None:
        samplers = animation["samplers"]
        end = max(float(self.accessor(s["input"])[-1, 0]) for s in samplers)
        for channel in animation["channels"]:
            sampler, target = samplers[channel["sampler"]], channel["target"]
            times, values = self.accessor(sampler["input"])[:, 0], self.accessor(sampler["output"])
            if target["path"] == "weights" or "node" not in target:
                continue
            if sampler.get("interpolation") == "CUBICSPLINE":
                values = values[1::3]
            nodes[target["node"]][target["path"]] = _between(times, values, moment * end, target["path"])

    def _triangles(self, world: Floats) -> Triangles:
        corners, colours = [], []
        for n, node in enumerate(self.document["nodes"]):
            for part in self.document["meshes"][node["mesh"]]["primitives"] if "mesh" in node else ():
                if part.get("mode", TRIANGLES) != TRIANGLES:
                    continue
                at = self.accessor(part["attributes"]["POSITION"]).astype(np.float64)
                order = self.accessor(part["indices"])[:, 0].astype(int) if "indices" in part else np.arange(len(at))
                corners.append(self._placed(node, part, world, n, at)[order].reshape(-1, 3, 3))
                colours.append(self._colours(part, len(at))[order].reshape(-1, 3, 3))
        return Triangles(np.concatenate(corners), np.concatenate(colours))

    def _placed(self, node: dict[str, Any], part: dict[str, Any], world: Floats, n: int, at: Floats) -> Floats:
        """(V, 3) vertices in the world."""
        points = np.concatenate([at, np.ones((len(at), 1))], axis=1)
        if "skin" not in node:
            return (points @ world[n].T)[:, :3]
        skin = self.document["skins"][node["skin"]]
        inverse = self.accessor(skin["inverseBindMatrices"]).reshape(-1, 4, 4).transpose(0, 2, 1)
        bones = world[skin["joints"]] @ inverse  # (J, 4, 4)
        joints = self.accessor(part["attributes"]["JOINTS_0"]).astype(int)
        weights = self.accessor(part["attributes"]["WEIGHTS_0"]).astype(np.float64)
        weights = weights / np.maximum(weights.sum(axis=1, keepdims=True), 1e-9)
        return np.einsum("vj,vjab,vb->va", weights, bones[joints], points)[:, :3]

    def _colours(self, part: dict[str, Any], count: int) -> Floats:
        material = self.document["materials"][part["material"]] if "material" in part else {}
        surface = material.get("pbrMetallicRoughness", {})
        colours = np.tile(
            np.array(surface.get("baseColorFactor", [1, 1, 1, 1])[:3], np.float64) ** (1 / 2.2), (count, 1)
        )
        if "baseColorTexture" in surface and "TEXCOORD_0" in part["attributes"]:
            picture = self._picture(self.document["textures"][surface["baseColorTexture"]["index"]]["source"])
            uv = self.accessor(part["attributes"]["TEXCOORD_0"]) % 1.0
            height, width = picture.shape[:2]
            colours = colours * picture[(uv[:, 1] * (height - 1)).astype(int), (uv[:, 0] * (width - 1)).astype(int)]
        return colours

    def _picture(self, source: int) -> Floats:
        if source not in self.pictures:
            view = self.document["bufferViews"][self.document["images"][source]["bufferView"]]
            start = view.get("byteOffset", 0)
            with Image.open(io.BytesIO(self.chunk[start : start + view["byteLength"]])) as image:
                self.pictures[source] = np.asarray(image.convert("RGB"), np.float64) / 255
        return self.pictures[source]


def _local(node: dict[str, Any]) -> Floats:
    if "matrix" in node:
        return np.reshape(node["matrix"], (4, 4)).T.astype(np.float64)
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_quat(node.get("rotation", [0, 0, 0, 1])).as_matrix() * node.get("scale", [1, 1, 1])
    matrix[:3, 3] = node.get("translation", [0, 0, 0])
    return matrix


def _between(times: NDArray, values: NDArray, at: float, path: str) -> Floats:
    at = float(np.clip(at, times[0], times[-1]))
    if path == "rotation" and len(times) > 1:
        return np.asarray(Slerp(times, Rotation.from_quat(values))(at).as_quat())
    return np.array([np.interp(at, times, column) for column in values.T])


def _standing(normals: Floats) -> Floats:
    """(N, 4) w, x, y, z of turns that take the z axis to normals (N, 3) of length 1."""
    turns = np.stack([1 + normals[:, 2], -normals[:, 1], normals[:, 0], np.zeros(len(normals))], axis=1)
    turns[turns[:, 0] < 1e-9] = [0, 1, 0, 0]
    return turns / np.linalg.norm(turns, axis=1, keepdims=True)


FRAMES = 3
ROWS = 8000  # of a model
RIGHT = np.cos(np.radians(25))
LYING = re.compile("death|dead|die|lie|lying", re.IGNORECASE)
COLUMNS = {
    "scene": ("scene", ""), "kind": ("weights", ""), "comes": ("as it comes", ""),
    "quarters": ("turned from axis to axis", ".0%"), "turned": ("turned anyhow", ".0%"),
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Options:
    scenes: tuple[str, ...] = required("SCENE=UP, such as head/=y, or .glb models")
    held: tuple[str, ...] = setting((), "names of those by whom no weight was chosen")
    turns: int = setting(24, "of each kind")
    tilt: float = setting(5.0, "degrees, standard deviation about each axis")


def run(options: Options, lab: Lab) -> Page:
    rows = [measure(scene, options) for scene in options.scenes]
    answer = " ".join(share for kind in ("tuned", "held back") if (share := _words(rows, kind)))
    return Page([Section(answer, tables=[Table("upright", rows, COLUMNS)])])


def measure(scene: str, options: Options) -> Row:
    place, _, told = scene.partition("=")
    up, name, rng = np.array(parse_up(told or "y"), np.float64), Path(place).stem, np.random.default_rng(0)
    shown = _moments(Path(place), rng) if place.endswith(".glb") else repeat(_frames(place))
    quarters = list(Rotation.create_group("O"))
    right: dict[str, list[bool]] = {"quarters": [], "turned": []}
    for i in range(options.turns):
        tilt = Rotation.from_rotvec(rng.normal(0, np.radians(options.tilt), 3))
        turns = {"quarters": tilt * quarters[i % len(quarters)], "turned": Rotation.random(random_state=i)}
        for how, turn in turns.items():
            right[how].append(is_upright([turned(frame, turn) for frame in next(shown)], turn.apply(up)))
    comes = "upright" if is_upright(next(shown), up) else "not"
    kind = "held back" if name in options.held else "tuned"
    shares = {how: float(np.mean(found)) for how, found in right.items()}
    return {"scene": name, "kind": kind, "comes": comes, "count": options.turns, **shares}


def is_upright(frames: Sequence[Gaussians], up: NDArray[np.float64]) -> bool:
    """Whether `up` (3,) points up in the picture that viewers of these frames begin at."""
    first = find_viewpoints(frames).cameras[0]
    return float(-first.world_to_camera[1, :3] @ up) > RIGHT


def turned(gaussians: Gaussians, turn: Rotation) -> Gaussians:
    quaternions = multiply(np.roll(turn.as_quat(), 1), gaussians.quaternions.astype(np.float64))
    means = gaussians.means @ turn.as_matrix().T
    return replace(gaussians.with_degree(0), means=means.astype(np.float32), quaternions=quaternions.astype(np.float32))


def _words(rows: Sequence[Row], kind: str) -> str:
    of = [row for row in rows if row["kind"] == kind]
    if not of:
        return ""
    comes = sum(row["comes"] == "upright" for row in of)
    quarters, turned = (np.mean([row[how] for row in of]) for how in ("quarters", "turned"))
    return f"{kind}: {comes} of {len(of)} upright as they come, {quarters:.0%} turned by quarters, {turned:.0%} anyhow."


def _frames(place: str) -> list[Gaussians]:
    sequence = open_sequence(place)
    return [repair([sequence.read(i)], place).frames[0] for i in evenly_spaced(len(sequence), FRAMES)]


def _moments(path: Path, rng: np.random.Generator) -> Iterator[list[Gaussians]]:
    model = Model.of(path)
    named = enumerate(model.document.get("animations", []))
    standing = [i for i, animation in named if not LYING.search(animation.get("name") or "")]
    while True:
        animation = standing[int(rng.integers(len(standing)))] if standing else None
        times: NDArray[np.float64] = np.sort(rng.uniform(0, 1, FRAMES))
        yield [model.frame(animation, moment, ROWS) for moment in times]
