"""Robots in ir-sim, driving circles: `python ir_sim_fleet.py ROBOTS SECONDS`, without zensim.

It runs in an environment of its own, which has ir-sim. Steps are of 0.1 s, the default, and no
figure is made. Prints steps, length of a step, wall and CPU time, and the mean speed of the robots
as JSON.
"""

import json
import math
import sys
import tempfile
import time
from pathlib import Path

import irsim
import numpy as np

SPACING_M, RADIUS_M = 5.0, 0.2
LINEAR, ANGULAR = 0.2, 0.5
STEP_S = 0.1
SETTLE_STEPS = 20


def make_world(robots: int) -> dict[str, object]:
    """Make the description of robots on a grid, without walls, that stop when they touch."""
    side = math.ceil(math.sqrt(robots))
    places = [
        [SPACING_M * (0.5 + number % side), SPACING_M * (0.5 + number // side), 0.0]
        for number in range(robots)
    ]
    robot = {
        "number": robots,
        "distribution": {"name": "manual"},
        "kinematics": {"name": "diff"},
        "shape": {"name": "circle", "radius": RADIUS_M},
        "vel_max": [1.0, 2.0],
        "state": places,
        "goal": [[0.0, 0.0, 0.0]] * robots,
        "arrive_mode": "state",
    }
    size = SPACING_M * side
    world = {"height": size, "width": size, "step_time": STEP_S, "collision_mode": "stop"}
    return {"world": world, "robot": [robot]}


def drive(robots: int, seconds: float) -> dict[str, float]:
    """Drive circles for some wall time."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "world.yaml"
        path.write_text(json.dumps(make_world(robots)), encoding="utf-8")  # JSON is YAML, too.
        world = irsim.make(str(path), headless=True, log_level="ERROR")
    actions = [np.array([[LINEAR], [ANGULAR]]) for _ in range(robots)]
    numbers = list(range(robots))
    for _ in range(SETTLE_STEPS):
        world.step(actions, numbers)
    before = read_places(world)
    world.step(actions, numbers)
    speed = np.linalg.norm(read_places(world) - before, axis=1).mean() / STEP_S
    steps, began_s, began_cpu_s = 0, time.perf_counter(), time.process_time()
    while (wall_s := time.perf_counter() - began_s) < seconds:
        world.step(actions, numbers)
        steps += 1
    cpu_s = time.process_time() - began_cpu_s
    world.end()
    return {"steps": steps, "step_s": STEP_S, "wall_s": wall_s, "cpu_s": cpu_s, "speed": speed}


def read_places(world: "irsim.env.EnvBase") -> np.ndarray:
    """Read the position of each robot [m]."""
    return np.array([robot.state[:2, 0] for robot in world.robot_list])


if __name__ == "__main__":
    sys.stdout.write(json.dumps(drive(int(sys.argv[1]), float(sys.argv[2]))) + "\n")
