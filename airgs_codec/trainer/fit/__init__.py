"""Fitting the Gaussians of one frame."""
