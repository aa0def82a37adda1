"""When steps are made: requested steps, lockstep with agents, statistics of the loop."""
