"""SDF models and worlds."""
