"""Rate and distortion of packages beside published layouts and formats."""
