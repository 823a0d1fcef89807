"""Trial encodes: what channels cost as one atlas, and what they decode to. T frames, C channels, N rows."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from airgs_codec.coding import escapes
from airgs_codec.coding.atlas import assemble, centre_codes, fit_atlas, picture_size, read_codes
from airgs_codec.coding.quantize import from_codes, to_codes
from airgs_codec.coding.rangecoder import encode_columns
from airgs_codec.media.h264 import ClosedGop, CodecSettings, decode_pictures, encode_gop, open_segment, qp_step


def encode_and_decode(
    values: NDArray[np.float64], steps: NDArray[np.float64], codec: CodecSettings
) -> tuple[list[int], NDArray[np.float64]]:
    """(T, C, N) values, (C,) steps -> bytes of each of T pictures, escapes in the first, and the decoded (T, C, N)."""
    gain = qp_step(codec.qp)
    codes = to_codes(values, steps, gain)
    atlas = fit_atlas(codes, gain / 2)
    if not atlas.planes:
        centres = np.array(atlas.centres, np.int32)[:, None]
        return [0] * len(codes), np.broadcast_to(from_codes(centres, steps, gain), values.shape).astype(np.float64)
    luma, bases = escapes.split(centre_codes(codes, atlas))
    size = picture_size(atlas)
    coded = encode_gop(ClosedGop(assemble(luma, atlas, *size), 0, 1), size, Fraction(30), codec)
    sizes = list(coded.picture_bytes)
    sizes[0] += len(encode_columns(escapes.Escapes.of(bases).columns()))
    pictures = decode_pictures(open_segment(coded.media, "a trial").samples, "a trial", coded.pages)
    decoded = [from_codes(read_codes(p, atlas, b), steps, gain) for p, b in zip(pictures, bases, strict=True)]
    return sizes, np.stack(decoded).astype(np.float64)
