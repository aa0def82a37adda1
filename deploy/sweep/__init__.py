"""Sweeps: many runs of a scenario with other values, seeds and repeats."""
