"""Robots of our own with the shapes of collisions that public ones have."""
