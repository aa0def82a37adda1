"""The sensor process: lidars, range finders and cameras, computed from the poses of a world."""
