"""How fast, how small: measured, not asserted."""
