"""Kinematics and limits of each drive, for floats and for arrays alike."""
