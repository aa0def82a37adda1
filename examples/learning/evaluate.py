"""Drive new worlds by a trained policy, and print how the robots fared.

    python examples/learning/evaluate.py                # the baselines of all tasks
    python examples/learning/evaluate.py avoid          # the baseline of a task
    python examples/learning/evaluate.py avoid.npz      # a file of ppo.py

Worlds are drawn by a seed that training does not use; each is driven for one episode.
"""

import argparse
from typing import NamedTuple

import numpy as np

from zensim.envs import Policy, ZensimVectorEnv, load_baseline

SEED = 1_000_000
TASKS = ("reach", "avoid", "formation", "pursue", "cover")
COLUMNS = 5


class Outcome(NamedTuple):
    """How the episodes ended, (worlds, robots).

    Attributes:
        succeeded: Whether a robot did its task.
        failed: Whether it had to end, by a collision in most tasks.
        rewards: Sums over the episode.
        seconds: From the start to the end of each episode, (worlds,).
        paths: x, y [m] of the robots of the first world, (steps, robots, 2).
    """

    succeeded: np.ndarray
    failed: np.ndarray
    rewards: np.ndarray
    seconds: np.ndarray
    paths: np.ndarray


def drive(policy: Policy, worlds: int, seed: int) -> Outcome:
    """Drive each world until its episode ends."""
    env = ZensimVectorEnv(worlds, task=policy.task, **policy.settings)
    observations, _ = env.reset(seed=seed)
    shape = observations.shape[:2]
    is_open, paths = np.ones(worlds, np.bool_), []
    succeeded, failed = np.zeros(shape, np.bool_), np.zeros(shape, np.bool_)
    rewards, seconds = np.zeros(shape), np.zeros(worlds)
    while is_open.any():
        if is_open[0]:
            paths.append(env.batch.poses2d[0, :, :2].copy())
        observations, _, terminated, truncated, infos = env.step(policy.act(observations))
        rewards[is_open] += infos["robot_rewards"][is_open]
        ends = is_open & (terminated | truncated)
        succeeded[ends] = infos["robot_success"][ends]
        failed[ends] = (infos["robot_over"] & ~infos["robot_success"])[ends]
        seconds[is_open] += 1.0 / policy.settings.get("rate_hz", 10.0)
        is_open &= ~ends
    env.close()
    return Outcome(succeeded, failed, rewards, seconds, np.array(paths))


def draw(path: str, ways: dict[str, np.ndarray]) -> None:
    """Draw the ways of the robots of each first world, from dots to squares."""
    from matplotlib.figure import Figure  # noqa: PLC0415 - only with --picture

    columns = min(len(ways), COLUMNS)
    rows = -(-len(ways) // columns)
    figure = Figure(figsize=(3.2 * columns, 3.2 * rows), layout="constrained")
    for axes in figure.subplots(rows, columns, squeeze=False).flat[len(ways) :]:
        axes.set_axis_off()
    for axes, (task, paths) in zip(figure.axes, ways.items(), strict=False):
        for way in paths.transpose(1, 0, 2):
            (line,) = axes.plot(*way.T, linewidth=1.2)
            axes.plot(*way[0], "o", *way[-1:].T, "s", color=line.get_color(), markersize=4)
        axes.set(title=task)
        axes.set_aspect("equal", adjustable="datalim")
        axes.grid(alpha=0.3)
    figure.savefig(path, dpi=100)


def main() -> None:
    """Print the shares of robots that succeeded and failed, and of worlds where none failed."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("policies", nargs="*", default=TASKS, help="tasks of baselines, or .npz")
    parser.add_argument("--worlds", type=int, default=256)
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--picture", default="", help="PNG file of the ways in the first worlds")
    options = parser.parse_args()
    ways = {}
    for word in options.policies:
        policy = Policy.load(word) if word.endswith(".npz") else load_baseline(word)
        found = drive(policy, options.worlds, options.seed)
        ways[policy.task] = found.paths
        print(
            f"task={policy.task} worlds={options.worlds} robots={found.succeeded.size}",
            f"succeeded={found.succeeded.mean():.3f} failed={found.failed.mean():.3f}",
            f"worlds_without_failure={(~found.failed.any(axis=1)).mean():.3f}",
            f"reward={found.rewards.mean():.2f} seconds={found.seconds.mean():.1f}",
            flush=True,
        )
    if options.picture:
        draw(options.picture, ways)


if __name__ == "__main__":
    main()
