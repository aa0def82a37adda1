"""The simulation server: one process that runs one world and serves it over the network."""
