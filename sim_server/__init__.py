"""The sim server: one process, one world, answered over the network."""
