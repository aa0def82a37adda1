"""Driving robots by keyboard and gamepad: keys, sticks, and the twists that they stand for."""
