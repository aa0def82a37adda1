"""The operator's side: put robots into a world, look at it, change it."""
