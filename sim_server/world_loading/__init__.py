"""Finds, loads and builds worlds."""
