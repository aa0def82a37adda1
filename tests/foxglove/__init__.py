"""Tests of the live server for Foxglove."""
