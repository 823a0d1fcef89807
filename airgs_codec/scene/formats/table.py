"""The formats of a frame: which files are theirs, and what reads a header and the rows."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from airgs_codec.errors import SceneError
from airgs_codec.scene.formats import clips, compressed_ply, gltf, library, sog, splat, spz
from airgs_codec.scene.formats.axes import Axes
from airgs_codec.scene.formats.holds import Holds
from airgs_codec.scene.gaussians import Gaussians
from airgs_codec.scene.ply import PlyHeader, read_ply, read_ply_header, write_ply
from airgs_codec.scene.ply_elements import read_header


@dataclass(frozen=True, slots=True)
class Format:
    """A format of files that hold one frame; its functions raise SceneError."""

    name: str
    key: str  # in options; written files end in it, after a dot
    suffixes: tuple[str, ...]  # of files that are read
    read_header: Callable[[Path], PlyHeader]
    read: Callable[[Path], Gaussians]
    write: Callable[[Path, Gaussians], None]  # of Gaussians as `holds` makes them fit
    holds: Holds
    writer: str = ""  # the library that `write` needs
    axes: Axes | None = None  # as its specification says; None: it does not, or files do not keep to it


INRIA = Format("INRIA .ply", "ply", (".ply",), read_ply_header, read_ply, write_ply, Holds())
COMPRESSED = Format(
    "compressed .ply",
    "compressed.ply",
    (".ply",),
    compressed_ply.read_compressed_header,
    compressed_ply.read_compressed,
    compressed_ply.write_compressed,
    compressed_ply.COMPRESSED_PLY,
)
SPZ = Format(
    ".spz", "spz", (".spz",), spz.read_spz_header, spz.read_spz, spz.write_spz, spz.SPZ, spz.WRITER, Axes((0, 1, 0))
)
SOG = Format("SOG", "sog", (".sog", ".zip"), sog.read_sog_header, sog.read_sog, sog.write_sog, sog.SOG, library.LIBRARY)
SPLAT = Format(
    ".splat", "splat", (".splat",), splat.read_splat_header, splat.read_splat, splat.write_splat, splat.SPLAT
)
GLTF = Format(
    "glTF",
    "glb",
    (".glb", ".gltf"),
    gltf.read_gltf_header,
    gltf.read_gltf,
    gltf.write_glb,
    gltf.GLB,
    axes=Axes((0, 1, 0), metres=1.0),
)
FORMATS = (INRIA, COMPRESSED, SPZ, SOG, SPLAT, GLTF)
_BY_SUFFIX = {suffix: form for form in FORMATS for suffix in form.suffixes}
SUFFIXES = tuple(dict.fromkeys(suffix for form in FORMATS for suffix in form.suffixes))


def is_frame(path: Path) -> bool:
    """Whether a name is that of a frame, or a folder is one (SOG). Hidden files are none, such as ._1.ply of macOS."""
    if path.name.startswith("."):
        return False
    return sog.is_sog_folder(path) if path.is_dir() else path.suffix.lower() in _BY_SUFFIX


def format_of(path: Path) -> Format:
    """The format of a file or folder. Raises SceneError when it is none of the table's."""
    if path.is_dir():
        return SOG
    if clip := clips.clip_format(path):
        raise SceneError(f"{path}: expected one frame, got {clip.name}, which holds many: give it by its own name")
    form = _BY_SUFFIX.get(path.suffix.lower())
    if form is None:
        known = ", ".join((*SUFFIXES, *clips.SUFFIXES))
        raise SceneError(f"{path}: expected one of {known}, got {path.suffix or 'no suffix'}")
    if form.suffixes == INRIA.suffixes:
        return COMPRESSED if compressed_ply.is_compressed(read_header(path)) else INRIA
    return form


def read_frame_header(path: Path) -> PlyHeader:
    """Count and SH degree of a frame of any format, without its rows. Raises SceneError."""
    try:
        return format_of(path).read_header(path)
    except OSError as error:
        raise SceneError(f"{path}: cannot read: {error.strerror}") from error


def read_frame(path: Path) -> Gaussians:
    """A frame of any format, as its file has it. Raises SceneError."""
    try:
        return format_of(path).read(path)
    except OSError as error:
        raise SceneError(f"{path}: cannot read: {error.strerror}") from error
