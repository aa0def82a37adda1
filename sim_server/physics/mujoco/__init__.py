"""The MuJoCo engine: compiled models have slots, so that bodies are added without recompiling."""
