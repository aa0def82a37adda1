"""The operator's side: typed clients, spawning, the command line and the 3D page."""
