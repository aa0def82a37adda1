"""Hostile inputs: each is generated, and has the slug of its refusal."""
