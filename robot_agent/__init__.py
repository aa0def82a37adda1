"""The robot's side: one process drives entities from outside the server."""
