"""The language-neutral test vectors in manifests/vectors: `python -m tests.makers.vectors`.

Bytes are written by the encoder. What they mean is computed here by the formulas of FORMAT.md, so that the decoder is
tested against a second reading of the format and not against itself.
"""
