"""Tests of the drives, file by file."""
