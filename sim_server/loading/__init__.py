"""Putting a world into the place of the one before, and the one that a server begins with."""
