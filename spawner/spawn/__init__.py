"""Spawning: descriptions, their files, namespaces, poses and the requests."""
