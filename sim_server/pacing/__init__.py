"""How steps follow one another: goals, lockstep, and how the loop is doing."""
