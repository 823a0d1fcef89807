"""Splats in the formats that people have, written by the libraries that others write them with."""

from __future__ import annotations

import tempfile
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pygltflib
from gaussforge import GaussForge

from airgs_codec.scene.formats.gltf import EXTENSION
from airgs_codec.scene.formats.ply import write_ply
from airgs_codec.scene.gaussians import Gaussians

KINDS = {  # suffix of a file: what the library calls its format, and its version of .spz
    ".compressed.ply": ("compressed.ply", 3),
    ".v2.spz": ("spz", 2),
    ".v3.spz": ("spz", 3),
    ".v4.spz": ("spz", 4),
    ".sog": ("sog", 3),
    ".splat": ("splat", 3),
}
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
    """One frame of SOG as a folder."""
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
    blobs = [np.ascontiguousarray(c, np.float32).tobytes() for c in columns.values()]
    starts = np.cumsum([0, *map(len, blobs)]).tolist()
    types = {1: "SCALAR", 3: "VEC3", 4: "VEC4"}
    document = pygltflib.GLTF2(
        scene=0,
        scenes=[pygltflib.Scene(nodes=[0])],
        nodes=[pygltflib.Node(mesh=0, **node)],
        buffers=[pygltflib.Buffer(byteLength=starts[-1])],
        bufferViews=[
            pygltflib.BufferView(buffer=0, byteOffset=s, byteLength=len(b)) for s, b in zip(starts, blobs, strict=False)
        ],
        accessors=[
            pygltflib.Accessor(bufferView=i, componentType=5126, count=len(g), type=types[c.size // len(g)])
            for i, c in enumerate(columns.values())
        ],
        extensionsUsed=[EXTENSION],
    )
    attributes = pygltflib.Attributes(**{name: i for i, name in enumerate(columns)})
    extension = {EXTENSION: {"kernel": "ellipse", "colorSpace": "srgb_rec709_display"}}
    document.meshes = [
        pygltflib.Mesh(primitives=[pygltflib.Primitive(attributes=attributes, mode=0, extensions=extension)])
    ]
    document.set_binary_blob(b"".join(blobs))
    return b"".join(document.save_to_bytes())
