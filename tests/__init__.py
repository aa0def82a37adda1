"""Tests in the layout of the code; contract, integration, chaos and benchmarks span packages."""
