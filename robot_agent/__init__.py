"""Robot agents: processes that drive entities of a world from outside the server."""
