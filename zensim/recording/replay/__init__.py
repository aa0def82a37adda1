"""Publishes a recording again: time, topics, requests and keys of `zensim replay`."""
