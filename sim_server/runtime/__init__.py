"""The server loop and its input and output at each turn."""
