"""What comes in and goes out at each turn of the loop."""
