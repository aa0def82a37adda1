"""Benchmarks: measured, not asserted."""
