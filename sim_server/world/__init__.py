"""The pure core: entities and simulation time over an engine."""
