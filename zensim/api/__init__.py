"""The Python API: simulations in this process or on a server, robots, fleets and topics."""
