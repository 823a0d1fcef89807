"""Write web/src/media/probe-clip.ts: a picture of every luma, which tells a player what its browser makes of it.

    python -m tests.makers.probe_clip

Macroblock (x, y) of the 16 x 16 of the picture is flat, of luma 16 y + x. What the project's encoder made is checked
with its decoder: every sample is exactly that.
"""

from __future__ import annotations

import base64
from fractions import Fraction

import numpy as np

from airgs_codec.media.h264 import ClosedGop, CodecSettings, Pictures, encode_gop
from airgs_codec.media.mp4 import read_samples
from tests.support.paths import REPOSITORY

PATH = REPOSITORY / "web" / "src" / "media" / "probe-clip.ts"
BLOCK = 16  # samples, either side of a macroblock
QP = 4  # coarser steps do not return all flat blocks exactly

TEXT = """\
// Made by tests/makers/probe_clip.py, with the project's encoder, and checked with its decoder.

/** Blocks in a line, lines of blocks, and samples either side of a block: the picture is 256 x 256. */
export const PROBE_BLOCKS = {blocks};

/** A coded IDR picture with its parameter sets, as in an .m4s file; block (x, y) has luma 16 y + x in every sample. */
export const PROBE_CLIP =
{lines};
"""


def main() -> None:
    picture = np.kron(np.arange(BLOCK * BLOCK).reshape(BLOCK, BLOCK), np.ones((BLOCK, BLOCK))).astype(np.uint8)
    coded = encode_gop(ClosedGop([picture], 0, 1), picture.shape, Fraction(24), CodecSettings(QP, 1.0, between=0))
    (sample,) = read_samples(coded.fragment)
    (decoded,) = Pictures([sample], PATH.name)
    assert np.array_equal(decoded, picture), "the coded picture is not exact"
    letters = base64.b64encode(sample).decode()
    lines = [f'  "{letters[start : start + 112]}"' for start in range(0, len(letters), 112)]
    PATH.write_text(TEXT.format(blocks=BLOCK, lines=" +\n".join(lines)))
    print(f"{PATH.name}: {len(sample)} bytes of H.264")


if __name__ == "__main__":
    main()
