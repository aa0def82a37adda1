"""Entities, simulation time and claims over an engine; no network, no clock, no files."""
