"""Numbers <-> pictures, in both directions: what the encoder and the decoder share.

Gaussians <-> channels (`channels`, with `attributes`, `colour` and `motion`) <-> codes (`quantize`) <-> luma samples
and escapes (`escapes`) <-> pictures (`atlas`). What must be exact, canonical means above all (`grid`, `morton`), goes
into column files (`sidecar`, `rangecoder`). `steps`, `weights` and `roundtrip` serve the encoder's choices.
"""
