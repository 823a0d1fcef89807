"""What a scene is: Gaussians, sequences of frames on disk, cameras, usage. Nothing here knows the codec."""
