"""Scenario files: a run of a world as one YAML file with robots, behaviours, faults and checks."""
