"""Physics behind the Engine protocol."""
