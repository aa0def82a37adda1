"""Readers and clients that share no code with zensim, in JavaScript on packages of npm."""
