"""Train a policy for a task of zensim.envs: proximal policy optimization in one file, with JAX.

    pip install 'zensim[server,rl]' jax matplotlib
    python examples/learning/ppo.py avoid --save avoid.npz --picture curve.png
    python examples/learning/evaluate.py avoid.npz

All robots of all worlds share one policy. The file has what NumPy needs to apply it.
Source of the algorithm: Schulman et al., 'Proximal policy optimization algorithms', 2017.
"""

import argparse
import json
import time
from collections import deque
from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from zensim.envs import Policy, ZensimVectorEnv

HIDDEN = 64
STEPS, EPOCHS, MINIBATCHES = 32, 5, 8
GAMMA, LAMBDA, CLIP, ENTROPY, RATE = 0.98, 0.95, 0.2, 0.003, 1e-3
LEAST_RATE = 0.05
"""Share of the first learning rate that is left at the end."""
Parameters = dict[str, Any]
Moments = tuple[Parameters, Parameters, jax.Array]
"""Of slopes: means, means of squares, and their number."""
COUNTED = 2000
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


class Scale:
    """Mean and deviation of each number of the observations so far."""

    def __init__(self, size: int) -> None:
        self.mean, self._square, self._count = np.zeros(size), np.ones(size), 1e-4

    def add(self, rows: np.ndarray) -> None:
        """Count rows (n, d)."""
        share = len(rows) / (self._count + len(rows))
        self.mean = self.mean + share * (rows.mean(axis=0) - self.mean)
        self._square = self._square + share * ((rows**2).mean(axis=0) - self._square)
        self._count += len(rows)

    @property
    def deviation(self) -> np.ndarray:
        """Deviation (d,)."""
        return np.sqrt(np.maximum(self._square - self.mean**2, 1e-4))

    def apply(self, rows: np.ndarray) -> np.ndarray:
        """Give rows mean 0 and deviation 1."""
        return ((rows - self.mean) / self.deviation).astype(np.float32)


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
    parameters: Parameters, moments: Moments, batch: tuple[jax.Array, ...], rate: float
) -> tuple[Parameters, Moments]:
    """Make a step of Adam."""
    slopes = jax.grad(find_loss)(parameters, batch)
    length = jnp.sqrt(sum(jnp.sum(one**2) for one in jax.tree.leaves(slopes)))
    slopes = jax.tree.map(lambda one: one / jnp.maximum(1.0, length), slopes)
    first, second, count = moments
    first = jax.tree.map(lambda m, g: 0.9 * m + 0.1 * g, first, slopes)
    second = jax.tree.map(lambda v, g: 0.999 * v + 0.001 * g * g, second, slopes)
    count = count + 1.0

    def step(parameter: jax.Array, m: jax.Array, v: jax.Array) -> jax.Array:
        m, v = m / (1.0 - 0.9**count), v / (1.0 - 0.999**count)
        return parameter - rate * m / (jnp.sqrt(v) + 1e-8)

    return jax.tree.map(step, parameters, first, second), (first, second, count)


class Collector:
    """Steps the worlds, and keeps how the last episodes ended.

    Attributes:
        outcomes: Whether each robot succeeded; noted when the episode of its world ends, as those
            that succeed end first.
        scale: Of the observations.
    """

    def __init__(self, envs: list[ZensimVectorEnv], seed: int) -> None:
        self._envs = envs
        observations = [env.reset(seed=seed + at)[0] for at, env in enumerate(envs)]
        self._cuts = np.cumsum([one.size // one.shape[-1] for one in observations])[:-1]
        self.scale = Scale(observations[0].shape[-1])
        self._rows = self._flatten(observations)
        self._is_over = np.zeros(len(self._rows), np.bool_)
        self._is_restarting = np.zeros(len(self._rows), np.bool_)
        self.outcomes: deque[bool] = deque(maxlen=COUNTED)

    def collect(self, parameters: Parameters, key: jax.Array) -> Rollout:
        """Make some steps with the policy."""
        found = []
        for one in jax.random.split(key, STEPS):
            rows = self.scale.apply(self._rows)
            actions, log_probs, values = map(np.asarray, act(parameters, rows, one))
            found.append((rows, actions, log_probs, values, *self._step(actions)))
        last = np.asarray(act(parameters, self.scale.apply(self._rows), key)[2])
        columns = [np.stack(values) for values in zip(*found, strict=True)]
        next_values = np.concatenate([columns[3][1:], last[None]])
        return Rollout(*columns[:4], next_values, *columns[4:])

    def _step(self, actions: np.ndarray) -> tuple[np.ndarray, ...]:
        is_valid = ~self._is_over & ~self._is_restarting
        stepped = [
            self._step_env(env, part)
            for env, part in zip(self._envs, np.split(actions, self._cuts), strict=True)
        ]
        observations, *columns = zip(*stepped, strict=True)
        rewards, is_over, ends = (np.concatenate(one) for one in columns)
        is_cut = is_over | ends | self._is_restarting
        self._rows, self._is_over, self._is_restarting = self._flatten(observations), is_over, ends
        return rewards, is_valid & is_over, is_cut, is_valid

    def _step_env(self, env: ZensimVectorEnv, actions: np.ndarray) -> tuple[np.ndarray, ...]:
        """Step some worlds; return observations, rewards, robots that are over, ends of worlds."""
        shape = env.action_space.shape
        observations, _, terminated, truncated, infos = env.step(actions.reshape(shape))
        ends = terminated | truncated
        self.outcomes.extend(infos["robot_success"][ends].reshape(-1).tolist())
        over = infos["robot_over"].reshape(-1)
        return observations, infos["robot_rewards"].reshape(-1), over, np.repeat(ends, shape[1])

    def _flatten(self, observations: Sequence[np.ndarray]) -> np.ndarray:
        rows = np.concatenate([one.reshape(-1, one.shape[-1]) for one in observations])
        self.scale.add(rows.astype(np.float64))
        return rows


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
    parameters: Parameters,
    moments: Moments,
    rollout: Rollout,
    generator: np.random.Generator,
    rate: float,
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
        order = generator.permutation(len(flat[0]))
        order = order[: len(order) // MINIBATCHES * MINIBATCHES]
        for rows in order.reshape(MINIBATCHES, -1):
            batch = tuple(one[rows] for one in flat)
            parameters, moments = improve(parameters, moments, batch, rate)
    return parameters, moments


def draw_curve(path: str, curve: list[tuple[float, float]]) -> None:
    """Draw the share of robots that succeeded over the steps of robots."""
    from matplotlib.figure import Figure  # noqa: PLC0415 - only with --picture

    steps, shares = np.array(curve).T
    figure = Figure(figsize=(7.0, 3.5), layout="constrained")
    axes = figure.subplots()
    axes.plot(steps / 1e6, 100.0 * shares, color="#1f6feb")
    axes.set_xlabel("steps of robots, standing ones too [million]")
    axes.set_ylabel("robots that succeeded [%]")
    axes.set_ylim(0.0, 100.0)
    axes.grid(alpha=0.3)
    figure.savefig(path, dpi=120)


def parse_options() -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("task", nargs="?", default="avoid")
    parser.add_argument("--updates", type=int, default=200)
    parser.add_argument("--worlds", type=int, default=256)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument(
        "--settings",
        action="append",
        help="of ZensimVectorEnv, as JSON; repeatable: equal shares of the worlds have each",
    )
    parser.add_argument("--save", default="", help="file of the policy, .npz")
    parser.add_argument("--picture", default="", help="PNG file of the curve")
    return parser.parse_args()


def save(path: str, task: str, settings: Any, parameters: Parameters, scale: Scale) -> None:  # noqa: ANN401
    """Save the policy, without what was needed to train it."""
    layers = [tuple(np.asarray(one) for one in layer) for layer in parameters["policy"]]
    spread = scale.mean.astype(np.float32), scale.deviation.astype(np.float32)
    Policy(task, settings, scale=spread, layers=layers).save(path)


def main() -> None:
    """Train, print the share of robots that succeeded, and save the policy."""
    options = parse_options()
    settings = [json.loads(one) for one in options.settings or ["{}"]]
    worlds = options.worlds // len(settings)
    envs = [ZensimVectorEnv(worlds, task=options.task, **one) for one in settings]
    collector = Collector(envs, options.seed)
    key, first = jax.random.split(jax.random.key(options.seed))
    parameters = make_parameters(first, len(collector.scale.mean), 2)
    zeros = jax.tree.map(jnp.zeros_like, parameters)
    moments = zeros, jax.tree.map(jnp.zeros_like, parameters), jnp.zeros(())
    generator = np.random.default_rng(options.seed)
    curve, began_s = [], time.perf_counter()
    for update in range(1, options.updates + 1):
        key, one = jax.random.split(key)
        rollout = collector.collect(parameters, one)
        rate = RATE * max(LEAST_RATE, 1.0 - (update - 1) / options.updates)
        parameters, moments = learn(parameters, moments, rollout, generator, rate)
        share = float(np.mean(collector.outcomes)) if collector.outcomes else 0.0
        curve.append((update * rollout.rewards.size, share))
        spent_s, reward = time.perf_counter() - began_s, float(rollout.rewards.mean())
        line = f"update={update} steps={curve[-1][0]} reward={reward:.4f} succeeded={share:.3f}"
        print(line, f"s={spent_s:.0f}", flush=True)
    for env in envs:
        env.close()
    if options.save:
        save(options.save, options.task, settings[0], parameters, collector.scale)
    if options.picture:
        draw_curve(options.picture, curve)


if __name__ == "__main__":
    main()
