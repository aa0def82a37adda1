"""Pure arithmetic on arrays: where links are, how they move, which solids overlap."""
