"""How the programs are put together."""
