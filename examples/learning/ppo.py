"""Learn to drive robots to goals: proximal policy optimization in one file, with JAX.

    pip install 'zensim[server,rl]' jax matplotlib
    python examples/learning/ppo_reach.py --picture curve.png

Sixteen worlds with four robots each share one policy. It takes a few minutes on two cores.
Source of the algorithm: Schulman et al., 'Proximal policy optimization algorithms', 2017.
"""

import argparse
import time
from collections import deque
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from zensim.envs import ZensimVectorEnv

ROBOTS, HIDDEN = 4, 64
STEPS, EPOCHS, MINIBATCHES = 32, 6, 4
GAMMA, LAMBDA, CLIP, ENTROPY, RATE = 0.97, 0.95, 0.2, 0.003, 1e-3
SCALE = np.array([3.0, 3.0, 0.5, 2.0], np.float32)
"""Of observations: goal x, y [m], forward velocity [m/s], turn [rad/s]."""
Parameters = dict[str, Any]
Moments = tuple[Parameters, Parameters, jax.Array]
"""Of slopes: means, means of squares, and their number."""
COUNTED = 256
"""Last robots of ended episodes, of which the share that succeeded is printed."""


class Rollout(NamedTuple):
    """What happened, (steps, rows, ...), a row for each robot of each world."""

    observations: np.ndarray
    actions: np.ndarray
    log_probs: np.ndarray
    values: np.ndarray
    next_values: np.ndarray
    rewards: np.ndarray
    is_terminated: np.ndarray
    is_cut: np.ndarray
    is_valid: np.ndarray


def make_parameters(key: jax.Array, observed: int, acted: int) -> Parameters:
    """Make a network with two outputs: means of actions, and a value."""
    sizes = (observed, HIDDEN, HIDDEN)
    keys = jax.random.split(key, 6)

    def layer(number: int, rows: int, columns: int, scale: float) -> tuple[jax.Array, jax.Array]:
        matrix = jax.random.orthogonal(keys[number], max(rows, columns))[:rows, :columns]
        return scale * matrix, jnp.zeros(columns)

    found: Parameters = {"log_std": jnp.full(acted, -0.5)}
    for part, offset, outputs, scale in (("policy", 0, acted, 0.01), ("value", 3, 1, 1.0)):
        hidden = [layer(offset + at, sizes[at], sizes[at + 1], 1.4) for at in range(2)]
        found[part] = [*hidden, layer(offset + 2, HIDDEN, outputs, scale)]
    return found


def apply_network(layers: list[Any], rows: jax.Array) -> jax.Array:
    """Apply linear layers with tanh between them."""
    for matrix, bias in layers[:-1]:
        rows = jnp.tanh(rows @ matrix + bias)
    return rows @ layers[-1][0] + layers[-1][1]


def find_log_probs(parameters: Parameters, rows: jax.Array, actions: jax.Array) -> jax.Array:
    """Find the logarithms of the densities of actions."""
    away = (actions - apply_network(parameters["policy"], rows)) / jnp.exp(parameters["log_std"])
    return jnp.sum(-0.5 * away**2 - parameters["log_std"] - 0.5 * jnp.log(2.0 * jnp.pi), axis=-1)


@jax.jit
def act(parameters: Parameters, rows: jax.Array, key: jax.Array) -> tuple[jax.Array, ...]:
    """Draw actions; return them with their densities and the values of the observations."""
    means = apply_network(parameters["policy"], rows)
    noise = jax.random.normal(key, means.shape)
    actions = means + jnp.exp(parameters["log_std"]) * noise
    values = apply_network(parameters["value"], rows)[..., 0]
    return actions, find_log_probs(parameters, rows, actions), values


def find_loss(parameters: Parameters, batch: tuple[jax.Array, ...]) -> jax.Array:
    """Find the loss of PPO of rows that count as much as their weights."""
    rows, actions, before, advantages, returns, weights = batch
    ratios = jnp.exp(find_log_probs(parameters, rows, actions) - before)
    clipped = jnp.clip(ratios, 1.0 - CLIP, 1.0 + CLIP)
    policy = -jnp.minimum(ratios * advantages, clipped * advantages)
    value = 0.5 * (apply_network(parameters["value"], rows)[..., 0] - returns) ** 2
    mean = jnp.sum((policy + value) * weights) / jnp.maximum(jnp.sum(weights), 1.0)
    return mean - ENTROPY * jnp.sum(parameters["log_std"])


@partial(jax.jit, donate_argnums=(0, 1))
def improve(
    parameters: Parameters, moments: Moments, batch: tuple[jax.Array, ...]
) -> tuple[Parameters, Moments]:
    """Make a step of Adam."""
    slopes = jax.grad(find_loss)(parameters, batch)
    first, second, count = moments
    first = jax.tree.map(lambda m, g: 0.9 * m + 0.1 * g, first, slopes)
    second = jax.tree.map(lambda v, g: 0.999 * v + 0.001 * g * g, second, slopes)
    count = count + 1.0

    def step(parameter: jax.Array, m: jax.Array, v: jax.Array) -> jax.Array:
        m, v = m / (1.0 - 0.9**count), v / (1.0 - 0.999**count)
        return parameter - RATE * m / (jnp.sqrt(v) + 1e-8)

    return jax.tree.map(step, parameters, first, second), (first, second, count)


class Collector:
    """Steps the worlds, and keeps how the last episodes ended.

    Attributes:
        outcomes: Whether each robot succeeded; noted when the episode of its world ends, as those
            that succeed end first.
    """

    def __init__(self, env: ZensimVectorEnv, seed: int) -> None:
        self._env = env
        self._rows = self._flatten(env.reset(seed=seed)[0])
        self._is_over = np.zeros(len(self._rows), np.bool_)
        self._is_restarting = np.zeros(len(self._rows), np.bool_)
        self.outcomes: deque[bool] = deque(maxlen=COUNTED)
        self.observed = self._rows.shape[1]

    def collect(self, parameters: Parameters, key: jax.Array) -> Rollout:
        """Make some steps with the policy."""
        found = []
        for one in jax.random.split(key, STEPS):
            actions, log_probs, values = map(np.asarray, act(parameters, self._rows, one))
            found.append((self._rows, actions, log_probs, values, *self._step(actions)))
        last = np.asarray(act(parameters, self._rows, key)[2])
        columns = [np.stack(values) for values in zip(*found, strict=True)]
        next_values = np.concatenate([columns[3][1:], last[None]])
        return Rollout(*columns[:4], next_values, *columns[4:])

    def _step(self, actions: np.ndarray) -> tuple[np.ndarray, ...]:
        shape = self._env.action_space.shape
        observations, _, terminated, truncated, infos = self._env.step(actions.reshape(shape))
        is_valid = ~self._is_over & ~self._is_restarting
        is_over = infos["robot_over"].reshape(-1)
        is_late = np.repeat(truncated, ROBOTS)
        is_terminated = is_valid & is_over
        is_cut = is_over | is_late | self._is_restarting
        self.outcomes.extend(infos["robot_success"][terminated | truncated].reshape(-1).tolist())
        self._rows, self._is_over = self._flatten(observations), is_over
        self._is_restarting = np.repeat(terminated | truncated, ROBOTS)
        return infos["robot_rewards"].reshape(-1), is_terminated, is_cut, is_valid

    @staticmethod
    def _flatten(observations: np.ndarray) -> np.ndarray:
        return np.asarray(observations.reshape(-1, observations.shape[-1]) / SCALE)


def find_advantages(rollout: Rollout) -> np.ndarray:
    """Estimate how much better actions were than the values of their observations."""
    ahead = np.where(rollout.is_terminated, 0.0, rollout.next_values)
    errors = rollout.rewards + GAMMA * ahead - rollout.values
    advantages, following = np.zeros_like(errors), np.zeros(errors.shape[1])
    for step in reversed(range(STEPS)):
        following = errors[step] + GAMMA * LAMBDA * following * ~rollout.is_cut[step]
        advantages[step] = following
    return advantages


def learn(
    parameters: Parameters, moments: Moments, rollout: Rollout, generator: np.random.Generator
) -> tuple[Parameters, Moments]:
    """Improve the network by one rollout."""
    advantages = find_advantages(rollout)
    returns = advantages + rollout.values
    known = advantages[rollout.is_valid]
    advantages = (advantages - known.mean()) / (known.std() + 1e-8)
    columns = (
        *(rollout.observations, rollout.actions, rollout.log_probs),
        *(advantages, returns, rollout.is_valid),
    )
    flat = [column.reshape(-1, *column.shape[2:]).astype(np.float32) for column in columns]
    for _ in range(EPOCHS):
        for rows in np.array_split(generator.permutation(len(flat[0])), MINIBATCHES):
            parameters, moments = improve(parameters, moments, tuple(one[rows] for one in flat))
    return parameters, moments


def draw_curve(path: str, curve: list[tuple[float, float]]) -> None:
    """Draw the share of episodes that succeeded over the steps of robots."""
    from matplotlib.figure import Figure  # noqa: PLC0415 - only with --picture

    steps, shares = np.array(curve).T
    figure = Figure(figsize=(7.0, 3.5), layout="constrained")
    axes = figure.subplots()
    axes.plot(steps / 1000.0, 100.0 * shares, color="#1f6feb")
    axes.set_xlabel("steps of robots, standing ones too [thousand]")
    axes.set_ylabel("goals reached [%]")
    axes.set_ylim(0.0, 100.0)
    axes.grid(alpha=0.3)
    figure.savefig(path, dpi=120)


def main() -> None:
    """Learn, and print the share of robots that reach their goals."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--updates", type=int, default=40)
    parser.add_argument("--worlds", type=int, default=16)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--picture", default="", help="PNG file of the curve")
    options = parser.parse_args()
    env = ZensimVectorEnv(
        options.worlds, task="reach", count=ROBOTS, spacing=8.0, rate_hz=5.0, time_limit_s=12.0
    )
    collector = Collector(env, options.seed)
    key, first = jax.random.split(jax.random.key(options.seed))
    parameters = make_parameters(first, collector.observed, 2)
    zeros = jax.tree.map(jnp.zeros_like, parameters)
    moments = zeros, jax.tree.map(jnp.zeros_like, parameters), jnp.zeros(())
    generator = np.random.default_rng(options.seed)
    curve, began_s = [], time.perf_counter()
    for update in range(1, options.updates + 1):
        key, one = jax.random.split(key)
        rollout = collector.collect(parameters, one)
        parameters, moments = learn(parameters, moments, rollout, generator)
        if collector.outcomes:
            share = float(np.mean(collector.outcomes))
            curve.append((update * rollout.rewards.size, share))
            spent_s = time.perf_counter() - began_s
            print(f"update={update} steps={curve[-1][0]} reached={share:.2f} s={spent_s:.0f}")
    env.close()
    if options.picture and curve:
        draw_curve(options.picture, curve)


if __name__ == "__main__":
    main()
