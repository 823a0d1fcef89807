"""Formats of others that are written here: TSOG, FTGS and .spz, and what they read back as.

All frames go into files of one format, which hold one or many of them; their bytes are what a viewer fetches.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path

from airgs_codec.errors import SceneError
from airgs_codec.scene.formats.packed import read_spz
from airgs_codec.scene.gaussians import Gaussians
from tools.lab import seconds_of
from tools.lab.rd.ftgs import read_ftgs, write_ftgs
from tools.lab.rd.programs import SPZ
from tools.lab.rd.subject import Coded, Subject, Trial
from tools.lab.rd.tsog import read_tsog, write_tsog

TSOG_SETTINGS = ((256, 1 << 16), (64, 1 << 12), (32, 1 << 10), (16, 1 << 8), (8, 1 << 6))  # levels, entries of palettes
SPZ_BITS = (12, 10, 8)  # of the fraction of a position; SH in all 8 bits, which splat-transform does not keep
Piece = tuple[int, Sequence[Gaussians]]  # the first frame, frames
Write = Callable[[Path, Sequence[Gaussians], float], None]
Read = Callable[[Path, int], Gaussians]


def written_trials() -> Iterator[Trial]:
    """TSOG in files of different lengths and depths, FTGS, and .spz with positions of different depths."""
    for name, cut in CUTS.items():
        yield Trial("TSOG", name, partial(_tsog, cut, TSOG_SETTINGS[0]))
    for setting in TSOG_SETTINGS[1:]:
        name = f"a file a group, {setting[0]} levels, palette of {setting[1]}"
        yield Trial("TSOG", name, partial(_tsog, _groups, setting))
    yield Trial("FTGS", "the longest files it can hold", _ftgs)
    for bits in SPZ_BITS:
        yield Trial(SPZ, f"gsply, version 3, {bits} bits", partial(_spz, bits))


def _whole(subject: Subject) -> list[Piece]:
    return [(0, [frame for _, frames in subject.groups for frame in frames])]


def _groups(subject: Subject) -> list[Piece]:
    return list(subject.groups)


def _frames(subject: Subject) -> list[Piece]:
    return [(start + i, [frame]) for start, frames in subject.groups for i, frame in enumerate(frames)]


CUTS = {"one file": _whole, "a file a group": _groups, "a file a frame": _frames}


def _tsog(cut: Callable[[Subject], list[Piece]], setting: tuple[int, int], subject: Subject) -> Coded:
    write = partial(write_tsog, levels=setting[0], palette=setting[1])
    return _clips(write, read_tsog, cut(subject), subject)


def _ftgs(subject: Subject) -> Coded:
    """FTGS holds what moves evenly alone: where the writer refuses frames, each half of them is a file of its own."""
    pieces, left = [], _groups(subject)
    with tempfile.TemporaryDirectory() as folder:
        while left:
            start, frames = left.pop()
            try:
                write_ftgs(Path(folder) / "tried", frames, float(subject.sequence.fps))
            except SceneError:
                half = len(frames) // 2
                if not half:
                    raise
                left += [(start, frames[:half]), (start + half, frames[half:])]
            else:
                pieces.append((start, frames))
    return _clips(write_ftgs, read_ftgs, pieces, subject)


def _clips(write: Write, read: Read, pieces: Sequence[Piece], subject: Subject) -> Coded:
    """A file for each piece, read back whole where a measured frame is in it; seconds are of the measured ones."""
    size, encode_s, decode_s = 0, 0.0, 0.0
    shown: dict[int, Gaussians] = {}
    with tempfile.TemporaryDirectory() as folder:
        for start, frames in pieces:
            path = Path(folder) / "clip"
            encode_s += seconds_of(partial(write, path, frames, float(subject.sequence.fps)))[0].wall
            size += path.stat().st_size
            for number in set(subject.measured) & set(range(start, start + len(frames))):
                took, shown[number] = seconds_of(partial(read, path, number - start))
                decode_s += took.wall
    return Coded(size / len(subject.sequence), shown, encode_s, decode_s)


def _spz(bits: int, subject: Subject) -> Coded:
    from gsply import GSData, write_spz  # of the extra `formats`

    size, encode_s, decode_s = 0, 0.0, 0.0
    shown: dict[int, Gaussians] = {}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "frame.spz"
        for number in range(len(subject.sequence)):
            g = subject.frame(number)
            sh = g.sh_dc, g.sh_rest if g.sh_degree else None
            data = GSData.from_arrays(g.means, g.log_scales, g.quaternions, g.opacity_logits, *sh, format="ply")
            encode_s += seconds_of(partial(write_spz, path, data, version=3, fractional_bits=bits))[0].wall
            size += path.stat().st_size
            if number in subject.measured:
                took, shown[number] = seconds_of(partial(read_spz, path))
                decode_s += took.wall
    return Coded(size / len(subject.sequence), shown, encode_s, decode_s)
