"""Splats in the formats that people have, written by the libraries that others write them with."""

from __future__ import annotations

import json
import tempfile
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pygltflib
from gaussforge import GaussForge
from PIL import Image

from tests.faces import Gaussians, write_ply

EXTENSION = "KHR_gaussian_splatting"

KINDS = {  # suffix of a file: what the library calls its format, and its version of .spz
    ".compressed.ply": ("compressed.ply", 3), ".sog": ("sog", 3), ".splat": ("splat", 3),
    ".v2.spz": ("spz", 2), ".v3.spz": ("spz", 3), ".v4.spz": ("spz", 4),
}  # fmt: skip

SUFFIXES = (*KINDS, ".glb")


def splat_bytes(g: Gaussians, suffix: str, **gltf: object) -> bytes:
    """A file of Gaussians; rows of SOG, .compressed.ply and .splat are in an order of the writer's."""
    if suffix == ".glb":
        return glb_bytes(g, **gltf)
    form, version = KINDS[suffix]
    if form == "compressed.ply":  # where the library writes all of a coefficient first, the format all of a colour
        g = replace(g, sh_rest=g.sh_rest.transpose(0, 2, 1).reshape(g.sh_rest.shape))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.ply"
        write_ply(path, g)
        answer = GaussForge().convert(path.read_bytes(), "ply", form, spz_version=version)
    return bytes(answer["data"])


def write_sog_folder(folder: Path, g: Gaussians) -> Path:
    archive = folder.with_suffix(".sog")
    archive.write_bytes(splat_bytes(g, ".sog"))
    with zipfile.ZipFile(archive) as opened:
        opened.extractall(folder)
    archive.unlink()
    return folder


def glb_bytes(g: Gaussians, **node: object) -> bytes:
    """A .glb of one node with splats; `node`: its transform."""
    with np.errstate(over="ignore"):
        alpha = 1 / (1 + np.exp(-g.opacity_logits))
    columns = {"POSITION": g.means, f"{EXTENSION}:SCALE": np.exp(g.log_scales), f"{EXTENSION}:OPACITY": alpha}
    quaternions = g.quaternions / np.linalg.norm(g.quaternions, axis=1, keepdims=True)
    columns[f"{EXTENSION}:ROTATION"] = quaternions[:, [1, 2, 3, 0]]
    columns[f"{EXTENSION}:SH_DEGREE_0_COEF_0"] = g.sh_dc
    bands = [(d, i) for d in range(1, g.sh_degree + 1) for i in range(2 * d + 1)]
    columns |= {f"{EXTENSION}:SH_DEGREE_{d}_COEF_{i}": g.sh_rest[:, k] for k, (d, i) in enumerate(bands)}
    document = pygltflib.GLTF2(scene=0, scenes=[pygltflib.Scene(nodes=[0])], extensionsUsed=[EXTENSION])
    document.nodes, data = [pygltflib.Node(mesh=0, **node)], b""
    for i, column in enumerate(columns.values()):
        kind = {1: "SCALAR", 3: "VEC3", 4: "VEC4"}[column.size // len(g)]
        document.accessors.append(pygltflib.Accessor(bufferView=i, componentType=5126, count=len(g), type=kind))
        document.bufferViews.append(pygltflib.BufferView(buffer=0, byteOffset=len(data), byteLength=4 * column.size))
        data += np.ascontiguousarray(column, np.float32).tobytes()
    document.buffers = [pygltflib.Buffer(byteLength=len(data))]
    attributes = pygltflib.Attributes(**{name: i for i, name in enumerate(columns)})
    extension = {EXTENSION: {"kernel": "ellipse", "colorSpace": "srgb_rec709_display"}}
    splats = pygltflib.Primitive(attributes=attributes, mode=0, extensions=extension)
    document.meshes = [pygltflib.Mesh(primitives=[splats])]
    document.set_binary_blob(data)
    return b"".join(document.save_to_bytes())


def write_sog_v1(folder: Path, g: Gaussians) -> Path:
    """A folder of SOG of version 1, which has bounds in place of codebooks; its palette has every row's SH."""
    folder.mkdir()
    files: dict[str, np.ndarray] = {}

    def coded(values: np.ndarray, most: int, axis: int | None = 0) -> tuple[dict[str, object], np.ndarray]:
        low, high = values.min(axis=axis), values.max(axis=axis)
        codes = np.rint((values - low) / np.where(high > low, high - low, 1) * most).astype(np.int64)
        return {"mins": low.tolist(), "maxs": high.tolist()}, codes

    def picture(name: str, channels: np.ndarray, alpha: np.ndarray | int, across: int) -> str:
        lines = -(-len(channels) // across)
        pixels = np.zeros((lines * across, 4), np.uint8)
        pixels[: len(channels), : channels.shape[1]] = channels
        pixels[: len(channels), 3] = alpha
        files[name] = pixels.reshape(lines, across, 4)
        return name

    bounds, codes = coded(np.sign(g.means) * np.log1p(np.abs(g.means)), 65535)
    names = [picture("means_l.webp", codes % 256, 255, 32), picture("means_u.webp", codes // 256, 255, 32)]
    meta: dict[str, object] = {"means": {"shape": [len(g), 3], "dtype": "float32", "files": names, **bounds}}
    bounds, codes = coded(g.log_scales, 255)
    meta["scales"] = {"files": [picture("scales.webp", codes, 255, 32)], **bounds}
    bounds, codes = coded(np.concatenate([g.sh_dc, g.opacity_logits[:, None]], axis=1), 255)
    meta["sh0"] = {"files": [picture("sh0.webp", codes[:, :3], codes[:, 3], 32)], **bounds}
    largest = np.abs(g.quaternions).argmax(axis=1)
    turned = g.quaternions * np.sign(g.quaternions[np.arange(len(g)), largest])[:, None]
    kept = np.stack([np.delete(q, i) for q, i in zip(turned, largest, strict=True)])
    codes = np.rint((kept * np.sqrt(2) + 1) / 2 * 255)
    meta["quats"] = {"encoding": "quaternion_packed", "files": [picture("quats.webp", codes, 252 + largest, 32)]}
    if g.sh_degree:
        bounds, codes = coded(g.sh_rest, 255, None)
        labels = np.stack([np.arange(len(g)) % 256, np.arange(len(g)) // 256], axis=1)
        palette = picture("shN_centroids.webp", codes.reshape(-1, 3), 255, 64 * g.sh_rest.shape[1])
        meta["shN"] = {"quantization": 8, "files": [palette, picture("shN_labels.webp", labels, 255, 32)], **bounds}
    for name, pixels in files.items():
        Image.fromarray(pixels).save(folder / name, "WEBP", lossless=True, exact=True)
    (folder / "meta.json").write_text(json.dumps(meta))
    return folder
