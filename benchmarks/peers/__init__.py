"""The same robots on the same circles in other simulators and in zensim, each a program."""
