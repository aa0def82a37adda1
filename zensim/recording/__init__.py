"""Recordings: MCAP files of the topics of a world, written, inspected and recovered."""
