"""glTF 2.0 with KHR_gaussian_splatting, .glb or .gltf: points with attributes, floats or integers; SH 0 to 3.

N rows. Sizes and opacities are stored as they are, without logarithm or logit; quaternions are x, y, z, w. Nodes may
move, turn and evenly scale splats; SH is not turned, so that turns are refused where splats have SH.
"""

from __future__ import annotations

import base64
import json
import math
import struct
from collections.abc import Iterator
from operator import index
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from airgs_codec.errors import SceneError
from airgs_codec.scene.camera import rigid
from airgs_codec.scene.formats.form import SIZES, Axes, FrameFormat, FrameHeader, Holds
from airgs_codec.scene.gaussians import SH_REST, Gaussians, logits_of, logs_of, multiply

EXTENSION = "KHR_gaussian_splatting"
_COLOURS = ("srgb_rec709_display", "BT.709")  # the second is of drafts
_TYPES = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
_WIDTHS_OF = {"POSITION": 3, f"{EXTENSION}:ROTATION": 4, f"{EXTENSION}:SCALE": 3, f"{EXTENSION}:OPACITY": 1}
_MOST_JSON = 1 << 24  # bytes
_MOST_BYTES = 1 << 32  # of a .glb, whose length is a word of 32 bits
_MOST_NODES = 10_000  # that are walked through, and primitives of splats in them
_TOLERANCE = 1e-3  # relative, of a matrix that turns and scales evenly
Document = dict[str, Any]


class _Placed(NamedTuple):
    """A primitive of splats with the transform of its node."""

    attributes: dict[str, int]  # numbers of accessors
    extension: dict[str, Any]
    matrix: NDArray[np.float64]  # (4, 4)
    scale: float  # its first three rows and columns are this times a rotation


def read_gltf_header(path: Path) -> FrameHeader:
    document, _ = open_gltf(path, only_json=True)
    return _header(document, list(_splats(document)))


def read_gltf(path: Path) -> Gaussians:
    """Read the splats of all nodes of the scene, one after another; positions are float64 where a node moves them.

    Raises SceneError.
    """
    document, chunk = open_gltf(path)
    primitives = list(_splats(document))
    degree = _header(document, primitives).sh_degree
    buffers = _buffers(path, document, chunk)
    return Gaussians.join([_read(document, buffers, p, degree) for p in primitives])


def open_gltf(path: Path, *, only_json: bool = False) -> tuple[Document, bytes]:
    """Return the JSON and, unless only that is asked for, the binary chunk."""
    with path.open("rb") as file:
        head = file.read(20)
        if head[:4] != b"glTF":
            text, chunk = head + file.read(_MOST_JSON), b""
            if len(text) > _MOST_JSON:
                raise ValueError(f"JSON of at most {_MOST_JSON} bytes; put the buffer in a file, or write a .glb")
        else:
            length = int.from_bytes(head[12:16], "little")
            if head[4:8] != b"\2\0\0\0" or head[16:20] != b"JSON" or length > _MOST_JSON:
                raise ValueError(f"a header of GLB 2, got {head!r}")
            text = file.read(length)
            chunk = b"" if only_json else file.read()[8:]
    return json.loads(text), chunk


def _header(document: Document, primitives: list[_Placed]) -> FrameHeader:
    """Return what the JSON promises."""
    if not primitives:
        raise ValueError("no node of its scene has splats")
    degrees, count = set(), 0
    for names, extension, matrix, scale in primitives:
        if extension.get("extensions"):
            raise ValueError(f"splats compressed by {', '.join(extension['extensions'])} are not read")
        if extension.get("kernel", "ellipse") != "ellipse" or extension.get("colorSpace", _COLOURS[0]) not in _COLOURS:
            raise ValueError(f"kernel ellipse in {_COLOURS[0]}, got {json.dumps(extension)[:120]}")
        degrees.add(SH_REST.index(sum(name in names for name in _harmonics(4)) - 1))
        if max(degrees) and np.abs(matrix[:3, :3] / scale - np.eye(3)).max() > _TOLERANCE:
            raise ValueError("splats with SH in a node that turns them")
        count += index(document["accessors"][names["POSITION"]]["count"])
    if len(degrees) > 1:
        raise ValueError(f"one SH degree, got {sorted(degrees)}")
    if not 0 <= count <= (most := sum(buffer["byteLength"] for buffer in document["buffers"])):
        raise ValueError(f"as many Gaussians as {most} bytes can hold, got {count}")
    return FrameHeader(count, degrees.pop())


def _splats(document: Document) -> Iterator[_Placed]:
    """Yield the primitives of splats of all nodes of the scene, in their order."""
    nodes = document["nodes"]
    roots = document["scenes"][document.get("scene", 0)]["nodes"] if document.get("scenes") else range(len(nodes))
    waiting: list[tuple[dict[str, Any], NDArray[np.float64]]] = [({"children": roots}, np.eye(4))]  # the last is next
    seen = 0
    while waiting:
        node, above = waiting.pop()
        matrix, below = above @ local_matrix(node), node.get("children", ())
        primitives = document["meshes"][node["mesh"]]["primitives"] if "mesh" in node else ()
        if (seen := seen + len(below) + len(primitives)) > _MOST_NODES:
            raise ValueError(f"at most {_MOST_NODES} nodes and primitives")
        waiting += [(nodes[number], matrix) for number in reversed(below)]
        for primitive in primitives:
            if (found := primitive.get("extensions", {}).get(EXTENSION)) is not None:
                if primitive.get("mode", 4) != 0:
                    raise ValueError(f"splats as points, got mode {primitive.get('mode', 4)}")
                yield _placed(primitive["attributes"], found, matrix)


def local_matrix(node: dict[str, Any]) -> NDArray[np.float64]:
    """Return the (4, 4) transform from a node to the one that it belongs to."""
    if "matrix" in node:
        return np.array(node["matrix"], np.float64).reshape(4, 4).T
    turn, scale = Rotation.from_quat(node.get("rotation", (0, 0, 0, 1))), np.array(node.get("scale", (1, 1, 1)), float)
    return rigid(turn.as_matrix() * scale, node.get("translation", (0, 0, 0)))


def _placed(attributes: dict[str, int], extension: dict[str, Any], matrix: NDArray[np.float64]) -> _Placed:
    turn = matrix[:3, :3]
    scale = max(float(np.linalg.det(turn)) if np.isfinite(matrix).all() else 0.0, 0.0) ** (1 / 3)
    if not scale > 0 or np.abs(turn @ turn.T / scale**2 - np.eye(3)).max() > _TOLERANCE:
        raise ValueError("a node that moves, turns and scales evenly")
    return _Placed(attributes, extension, matrix, scale)


def _harmonics(degree: int) -> list[str]:
    return [f"{EXTENSION}:SH_DEGREE_{d}_COEF_{i}" for d in range(degree + 1) for i in range(2 * d + 1)]


def _buffers(path: Path, document: Document, chunk: bytes) -> list[bytes]:
    """Return the bytes of all buffers, none of them twice and each as long as it says."""
    uris = [buffer.get("uri") for buffer in document["buffers"]]
    if len(set(uris)) < len(uris):
        raise ValueError(f"every buffer once, got {len(uris)} of {len(set(uris))} places")
    buffers = [chunk if uri is None else _buffer(path, uri) for uri in uris]
    for data, buffer in zip(buffers, document["buffers"], strict=True):
        if len(data) < buffer["byteLength"]:
            raise ValueError(f"a buffer of {buffer['byteLength']} bytes, got {len(data)}")
    return buffers


def _buffer(path: Path, uri: str) -> bytes:
    """Return the bytes of a buffer: base64 in the JSON, or a file in the same folder."""
    if uri.startswith("data:"):
        return base64.b64decode(uri.partition(",")[2], validate=True)
    name = unquote(uri)
    if Path(name).name != name or "\0" in name:
        raise ValueError(f"a buffer in its folder, got {uri[:80]!r}")
    try:
        return (path.parent / name).read_bytes()
    except OSError as error:
        raise SceneError(f"{path}: expected its buffer {name[:80]} in its folder: {error.strerror}") from error


def read_accessor(document: Document, buffers: list[bytes], accessor: int, width: int) -> NDArray[np.float32]:
    """Return (N, width) of an accessor; integers are divided by their largest where they are normalised."""
    a = document["accessors"][accessor]
    if "sparse" in a or _WIDTHS.get(a["type"]) != width:
        raise ValueError(f"an accessor of {width} values, not sparse, got {json.dumps(a)[:100]}")
    view, kind, count = document["bufferViews"][a["bufferView"]], np.dtype(_TYPES[a["componentType"]]), a["count"]
    size = width * kind.itemsize
    stride, start = view.get("byteStride", 0) or size, view.get("byteOffset", 0) + a.get("byteOffset", 0)
    data = buffers[view["buffer"]]
    if stride < size or start < 0 or start + (count - 1) * stride + size > len(data):
        raise ValueError(f"{count} rows of {stride} bytes from byte {start}, got a buffer of {len(data)}")
    if not count:
        return np.zeros((0, width), np.float32)
    values = np.ndarray((count, width), kind, data, start, (stride, kind.itemsize)).astype(np.float32)
    if a.get("normalized") and kind.kind != "f":
        values = np.maximum(values / np.float32(np.iinfo(kind).max), np.float32(-1))
    return values


def _read(document: Document, buffers: list[bytes], primitive: _Placed, degree: int) -> Gaussians:
    widths = _WIDTHS_OF | dict.fromkeys(_harmonics(degree), 3)
    columns = [read_accessor(document, buffers, primitive.attributes[name], width) for name, width in widths.items()]
    means, rotations, scales, alpha, dc, *rest = columns
    if {*map(len, columns)} != {len(means)}:
        raise ValueError(f"{len(means)} rows of every attribute")
    turn, shift = primitive.matrix[:3, :3], primitive.matrix[:3, 3]
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        log_scales = logs_of(scales) + math.log(primitive.scale)
        placed: NDArray[Any] = means @ turn.T + shift
    rotation = Rotation.from_matrix(turn / primitive.scale).as_quat(scalar_first=True)
    quaternions = multiply(np.broadcast_to(rotation, rotations.shape), rotations[:, [3, 0, 1, 2]])
    sh = np.stack(rest, axis=1) if rest else np.zeros((len(means), SH_REST[0], 3))
    others = (quaternions, log_scales, logits_of(alpha[:, 0]), dc, sh)
    kind = np.float64 if shift.any() else np.float32
    return Gaussians(placed.astype(kind), *(np.asarray(part, np.float32) for part in others))


def write_glb(path: Path, gaussians: Gaussians) -> None:
    """Write one frame of unit quaternions as a .glb of one node, all values as floats.

    Raises SceneError for more rows than a .glb can hold.
    """
    g = gaussians
    coefficients = g.sh_dc, *(g.sh_rest[:, i] for i in range(g.sh_rest.shape[1]))
    values = g.means, g.quaternions[:, [1, 2, 3, 0]], np.exp(g.log_scales), g.opacities(), *coefficients
    columns = dict(zip([*_WIDTHS_OF, *_harmonics(g.sh_degree)], values, strict=True))
    size = sum(column.nbytes for column in columns.values())
    text = json.dumps(_document_of(columns, size), separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    whole = 12 + 8 + len(text) + 8 + size
    if whole >= _MOST_BYTES:
        raise SceneError(f"{path}: expected less than {_MOST_BYTES} bytes of .glb, got {len(g)} Gaussians in {whole}")
    with path.open("wb") as file:
        file.write(struct.pack("<4sIII4s", b"glTF", 2, whole, len(text), b"JSON") + text)
        file.write(struct.pack("<I4s", size, b"BIN\0"))
        for column in columns.values():
            file.write(np.ascontiguousarray(column, "<f4").tobytes())


def _document_of(columns: dict[str, NDArray[np.float32]], size: int) -> Document:
    types = {width: name for name, width in _WIDTHS.items()}
    accessors, views, start = [], [], 0
    for i, column in enumerate(columns.values()):
        width = 1 if column.ndim == 1 else column.shape[1]
        accessors.append({"bufferView": i, "componentType": 5126, "count": len(column), "type": types[width]})
        views.append({"buffer": 0, "byteOffset": start, "byteLength": column.nbytes, "target": 34962})
        start += column.nbytes
    means = columns["POSITION"]
    accessors[0] |= {"min": means.min(axis=0).tolist(), "max": means.max(axis=0).tolist()}
    extension = {EXTENSION: {"kernel": "ellipse", "colorSpace": _COLOURS[0]}}
    primitive = {"mode": 0, "attributes": {name: i for i, name in enumerate(columns)}, "extensions": extension}
    return {
        "asset": {"version": "2.0", "generator": "airgs-codec"}, "extensionsUsed": [EXTENSION],
        "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}], "meshes": [{"primitives": [primitive]}],
        "buffers": [{"byteLength": size}], "bufferViews": views, "accessors": accessors,
    }  # fmt: skip


GLTF = FrameFormat(
    "glTF", "glb", (".glb", ".gltf"), read_gltf_header, read_gltf, write_glb,
    Holds(ranges=(SIZES,)), axes=Axes((0, 1, 0), metres=1.0),
)  # fmt: skip
