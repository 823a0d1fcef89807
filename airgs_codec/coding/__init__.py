"""Numbers <-> pictures, in both directions: what the encoder and the decoder share.

Gaussians <-> channels (`channels`, with steps of `motion`) <-> codes (`atlas`) <-> luma samples and escapes
(`escapes`) <-> pictures (`atlas`). What must be exact, canonical means above all, goes into column files
(`sidecar`, `rangecoder`). `kernels` works on rows, a few at a time.
"""
