"""Playing a package over a bandwidth trace: a deterministic simulation, and what the viewer saw."""
