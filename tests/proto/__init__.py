"""Tests of the wire, file by file."""
