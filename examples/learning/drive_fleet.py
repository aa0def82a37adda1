"""Drive the robots of a running server by a policy that was trained without one.

    zensim up --behaviour none
    python examples/learning/drive_fleet.py          # the baseline of the task 'avoid'
    python examples/learning/drive_fleet.py avoid.npz

The task makes the observations, as in training: the robots exchange their places.
"""

import argparse

import numpy as np

import zensim
from zensim.envs import AvoidEachOther, FleetView, Policy, WorldStreams, load_baseline

WORLD = np.arange(1)
"""The server's, among those of the task."""


def look(fleet: zensim.Fleet, now: float) -> FleetView:
    """See the fleet as the task does; it needs no contacts to observe."""
    poses, twists = fleet.poses2d(), fleet.twists()
    velocities = twists[:, [0, 5]]
    return FleetView(
        poses[None], velocities[None], np.zeros((1, len(fleet)), np.bool_), np.array([now])
    )


def find_gap(poses: np.ndarray) -> float:
    """Find the distance [m] of the two nearest robots, from middle to middle."""
    away = poses[:, None, :2] - poses[None, :, :2]
    return float((np.hypot(*away.T) + np.diag(np.full(len(poses), np.inf))).min())


def read_options() -> tuple[argparse.Namespace, Policy]:
    """Read the options, and load the policy."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("policy", nargs="?", default="", help=".npz; the baseline if none is given")
    parser.add_argument("--endpoint", default="tcp/127.0.0.1:7447")
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    try:
        policy = Policy.load(options.policy) if options.policy else load_baseline("avoid")
    except (OSError, zensim.Invalid) as error:
        parser.error(str(error))
    if policy.task != "avoid":
        parser.error(f"{options.policy} is a policy for '{policy.task}'; give one for 'avoid'")
    return options, policy


def main() -> None:
    """Drive until all have arrived, and print how many have, and how near two came."""
    options, policy = read_options()
    speed = policy.settings.get("max_speed_m_s", 0.5)
    turn, rate_hz = policy.settings.get("max_turn_rad_s", 2.0), policy.settings.get("rate_hz", 10.0)
    with zensim.connect(options.endpoint) as sim:
        fleet = sim.fleet(list(sim.robots))
        task, streams = AvoidEachOther(), WorldStreams(1)
        bounds = task.list_bounds(len(fleet))
        streams.seed(options.seed, WORLD)
        task.restart(WORLD, look(fleet, sim.time), streams)
        arrived, gap_m, began = np.zeros(len(fleet), np.bool_), np.inf, sim.time
        for now in sim.steps(seconds=options.seconds, rate=rate_hz):
            seen = look(fleet, now)
            gap_m = min(gap_m, find_gap(seen.poses[0]))
            arrived |= task.judge(seen).is_success[0]
            if arrived.all():
                break
            actions = policy.act(np.clip(task.observe(seen)[0], -bounds, bounds))
            actions[arrived] = 0.0
            fleet.drive(v=speed * actions[:, 0], w=turn * actions[:, 1])
        fleet.stop()
        print(f"robots={len(fleet)} arrived={arrived.sum()} least_gap_m={gap_m:.2f}", end=" ")
        print(f"seconds={sim.time - began:.1f}")


if __name__ == "__main__":
    main()
