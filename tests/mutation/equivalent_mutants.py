"""Mutants of the sample that change nothing that could be noticed, by name, and why."""

EQUIVALENTS: dict[str, str] = {}
