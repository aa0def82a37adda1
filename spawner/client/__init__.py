"""Typed clients of a simulation server."""
