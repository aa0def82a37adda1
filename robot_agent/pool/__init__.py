"""Many robots in one process: everything that robots of a kind do, in arrays."""
