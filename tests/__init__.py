"""Tests, laid out as the code is; contract, integration, chaos and benchmark go across it."""
