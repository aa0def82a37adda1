"""What the robots of `zensim up` may do by themselves; without numpy, as they start first."""

from typing import Literal

DemoBehaviour = Literal["circle", "waypoints", "random_walk", "none"]
DEMO_BEHAVIOURS: tuple[DemoBehaviour, ...] = ("circle", "waypoints", "random_walk", "none")
DESCRIPTIONS: dict[DemoBehaviour, str] = {
    "circle": "drive in circles",
    "waypoints": "drive in squares",
    "random_walk": "wander",
}


def describe_demo(behaviour: DemoBehaviour) -> str:
    """Say what the robots do, for how long, and how they would not."""
    return (
        f"The robots {DESCRIPTIONS[behaviour]}, each until something commands it "
        "(--behaviour none: they stand still)."
    )
