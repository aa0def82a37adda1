"""URDF descriptions."""
