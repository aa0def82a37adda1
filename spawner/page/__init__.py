"""The 3D page: a client of the network like any other."""
