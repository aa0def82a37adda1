"""Handlers of the services, and the registry that lists them."""
