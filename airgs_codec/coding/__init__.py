"""Numbers <-> pictures: attributes, channels, quantiser, escapes, atlases, sidecars. Encoder and decoder share it."""
