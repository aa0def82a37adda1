"""Inputs that no robot needs: each is made by a script, and has the slug of its refusal."""
