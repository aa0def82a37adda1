"""Commands that write and inspect recordings."""
