"""A crowd of viewers behind one edge: see tools/simulate_crowd.py."""
