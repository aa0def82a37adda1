"""What the robots of `zensim up` may do by themselves; without numpy, as they start first."""

from typing import Literal

PoseBehaviour = Literal["waypoints", "random_walk"]
"""Behaviours that depend on the poses of robots."""
MovingBehaviour = Literal["circle", PoseBehaviour]
DemoBehaviour = Literal[MovingBehaviour, "none"]
DEMO_BEHAVIOURS: tuple[DemoBehaviour, ...] = ("circle", "waypoints", "random_walk", "none")
DESCRIPTIONS: dict[MovingBehaviour, str] = {
    "circle": "drive in circles",
    "waypoints": "drive in squares",
    "random_walk": "wander",
}
SPEED = 0.3
"""[m/s]."""
RADIUS = 0.4
"""Radius of circles [m]; half of the side of squares."""


def describe_demo(behaviour: MovingBehaviour) -> str:
    """Say what the robots do, for how long, and how they would not."""
    return (
        f"The robots {DESCRIPTIONS[behaviour]}, each until something commands it "
        "(--behaviour none: they stand still)."
    )
