"""What `python -m tools.stiff` measures: sweeps to the ends of the trainer, the codec and the selector."""
