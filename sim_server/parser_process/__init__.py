"""Untrusted descriptions and files, parsed in a sandboxed process and cached by content."""
