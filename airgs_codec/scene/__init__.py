"""What a scene is: Gaussians, frames on disk, cameras, usage. Nothing here knows the codec."""
