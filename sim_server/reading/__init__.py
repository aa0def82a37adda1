"""Strangers' texts and files, read in a process of their own and kept by content."""
