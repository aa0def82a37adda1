"""Live server for Foxglove: topics of a world by the Foxglove WebSocket protocol, on demand."""
