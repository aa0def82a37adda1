"""Cells: bodies that cannot touch for a while are stepped in separate engines."""
