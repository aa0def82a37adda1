"""The log of what changed a world, and runs that repeat it."""
