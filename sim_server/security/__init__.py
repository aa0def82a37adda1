"""Secured servers: certificates, users and their tokens, and the router that admits them."""
