"""What MuJoCo compiles: slots for robots of a make, so that robots come and go at once."""
