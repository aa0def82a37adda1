"""Settings of programs: each stands once, as an annotated field of a group."""
