"""Scenes: Gaussians, sequences of frames on disk, cameras, usage. Nothing here knows the codec."""
