"""Formats that gaussforge reads and writes: through the library in a process of its own, its faults put right."""

from __future__ import annotations

import importlib.util
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from airgs_codec.errors import SceneError
from airgs_codec.scene.formats.form import FrameHeader
from airgs_codec.scene.formats.ply import read_ply, write_ply
from airgs_codec.scene.formats.sandbox import run_limited
from airgs_codec.scene.gaussians import SATURATED_LOGIT, Gaussians

LIBRARY = "gaussforge"
_COPIES = 16  # of a frame in float32, as input, in the library, as .ply


def expect_library(path: Path, form: str, library: str) -> None:
    """Raise SceneError, which says how to install it, when a library that a format needs is not there."""
    if importlib.util.find_spec(library) is None:
        raise SceneError(f"{path}: {form} files need {library}: pip install 'airgs-codec[formats]'")


def read_with_library(path: Path, form: str, data: bytes, header: FrameHeader) -> Gaussians:
    """The Gaussians in the bytes of a file whose header has been read; `form` is the library's name of the format.

    Raises SceneError when the library is not there, cannot read them, or finds others than the header promises.
    """
    expect_library(path, form, LIBRARY)
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / "frame.ply"
        reason = run_limited(LIBRARY, [form, "ply", str(target)], _COPIES * header.bytes, data)
        try:
            found = read_ply(target)
        except SceneError:
            raise SceneError(f"{path}: expected {form}, got what gaussforge cannot read: {reason}") from None
    if len(found) != header.count or found.sh_degree < header.sh_degree:
        expected = f"expected {header.count} Gaussians of SH degree {header.sh_degree} as its header says"
        raise SceneError(f"{path}: {expected}, got {len(found)} of {found.sh_degree}")
    infinite = np.isinf(found.opacity_logits)
    logits = np.where(infinite, np.sign(found.opacity_logits) * SATURATED_LOGIT, found.opacity_logits)
    return replace(found.with_degree(header.sh_degree), opacity_logits=logits.astype(np.float32))


def write_with_library(path: Path, form: str, gaussians: Gaussians) -> None:
    """Write one frame of unit quaternions; `form` is the library's name of the format.

    Raises SceneError when the library is not there or writes nothing.
    """
    expect_library(path, form, LIBRARY)
    with tempfile.TemporaryDirectory() as folder:
        source = Path(folder) / "frame.ply"
        write_ply(source, gaussians)
        more = _COPIES * FrameHeader(len(gaussians), gaussians.sh_degree).bytes
        reason = run_limited(LIBRARY, ["ply", form, str(path.absolute())], more, source.read_bytes(), seconds=None)
    if reason or not path.is_file():
        raise SceneError(f"{path}: gaussforge cannot write {len(gaussians)} Gaussians as {form}: {reason}")
