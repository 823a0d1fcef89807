"""Package -> Gaussians."""
