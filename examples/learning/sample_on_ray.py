"""Sample worlds in tasks of Ray: each has the hash that it has in this process.

    pip install 'zensim[server,rl,ray]'
    python examples/learning/sample_on_ray.py --tasks 4

Ray starts a cluster on this computer, or joins that of RAY_ADDRESS.
"""

import argparse
from hashlib import sha256

import numpy as np
import ray

from zensim.envs import ZensimVectorEnv

WORLDS, ROBOTS, STEPS = 64, 4, 100


def sample(seed: int) -> str:
    """Make steps with random actions; return the hash of observations, rewards and states."""
    env = ZensimVectorEnv(WORLDS, task="avoid", count=ROBOTS, threads=1)
    draw = np.random.default_rng(seed)
    found = sha256(env.reset(seed=seed)[0].tobytes())
    for _ in range(STEPS):
        observations, rewards, *_ = env.step(draw.uniform(-1.0, 1.0, (WORLDS, ROBOTS, 2)))
        found.update(observations.tobytes() + rewards.tobytes())
    for world in range(WORLDS):
        found.update(env.batch.digest(world).encode())
    env.close()
    return found.hexdigest()


def main() -> None:
    """Run the tasks on Ray and here, and compare."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--tasks", type=int, default=4)
    tasks = parser.parse_args().tasks
    ray.init(include_dashboard=False, log_to_driver=False)
    remote = ray.remote(sample)
    there = ray.get([remote.remote(seed) for seed in range(tasks)])
    for seed, found in enumerate(there):
        print(f"seed={seed} hash={found[:16]} is_same={found == sample(seed)}")
    ray.shutdown()


if __name__ == "__main__":
    main()
