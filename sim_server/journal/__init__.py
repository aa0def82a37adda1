"""The journal: a durable record of the world, from which a restarted server restores it."""
