"""The worlds that can be loaded, and how their texts are read."""
