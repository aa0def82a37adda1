"""Command line, and local deployment of all programs."""
