"""What the words of a request mean: entities, frames, links, regions."""
