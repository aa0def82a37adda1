"""Worlds in cells: bodies that cannot touch for a while are stepped by engines of their own."""
