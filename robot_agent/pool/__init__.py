"""Many robots in one process: robots of a group are driven and published in arrays."""
