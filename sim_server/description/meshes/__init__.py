"""Mesh files of descriptions."""
