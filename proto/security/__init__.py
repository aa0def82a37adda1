"""Roles of users of a secured server, and the access rules of Zenoh that follow from them."""
