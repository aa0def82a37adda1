"""How property tests run: as often as a commit can bear, or as `make fuzz` asks."""

from hypothesis import settings

# Cores are shared where tests run: how long one example takes says nothing.
settings.register_profile("commit", deadline=None)
settings.register_profile("fuzz", deadline=None, max_examples=5000)
settings.load_profile("commit")
