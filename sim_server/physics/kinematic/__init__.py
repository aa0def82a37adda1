"""Kinematic tier: robots moved by their drives alone, beside an engine with full dynamics."""
