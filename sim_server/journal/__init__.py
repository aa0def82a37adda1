"""What outlives a server: a log of its world, on disk before anybody is told."""
