"""Sessions of Zenoh: publishers, subscriptions, queries, tokens and calls."""
