"""Two tiers of physics: robots that only go as their drives say, and bodies of an engine."""
