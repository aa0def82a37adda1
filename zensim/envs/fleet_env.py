"""ZensimParallelEnv: the robots of one world as agents of PettingZoo."""

from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
from pettingzoo import ParallelEnv

from zensim.api.api_errors import Invalid
from zensim.envs.env_settings import find_task, make_settings
from zensim.envs.episodes import ACTION_COLUMNS, Episodes, Observations
from zensim.envs.robot_task import RobotTask
from zensim.envs.vector_env import Space, make_spaces

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from zensim.envs.batch import Batch
    from zensim.envs.env_settings import EnvKeywords

USUAL_COUNT = 4
Infos = dict[str, dict[str, Any]]
Actions = npt.NDArray[np.float32]


def parallel_env(
    task: str | RobotTask = "avoid", **options: "Unpack[EnvKeywords]"
) -> "ZensimParallelEnv":
    """Make a world whose robots are agents; four unless `count` or the task says otherwise."""
    return ZensimParallelEnv(task, **options)


class ZensimParallelEnv(ParallelEnv[str, Observations, Actions]):  # type: ignore[misc]
    """One world; each robot that learns is an agent until its own episode ends.

    A robot whose episode has ended stands still. `batch` has the arrays.
    """

    metadata = {"name": "zensim", "render_modes": []}  # noqa: RUF012 - of PettingZoo

    def __init__(self, task: str | RobotTask, **options: "Unpack[EnvKeywords]") -> None:
        """Make the world.

        Args:
            task: See `ZensimVectorEnv`.
            options: See `EnvKeywords`.

        Raises:
            Invalid: A setting is not valid.
            Unsupported: See `Batch`.
        """
        own = find_task(task)
        self._episodes = Episodes(own, make_settings(options, own, USUAL_COUNT), 1)
        self.possible_agents = list(self._episodes.names)
        self.agents: list[str] = []
        self._spaces = {name: make_spaces(self._episodes, ()) for name in self.possible_agents}
        self._rows = {name: row for row, name in enumerate(self.possible_agents)}

    @property
    def batch(self) -> "Batch":
        """The world as arrays."""
        return self._episodes.batch

    def observation_space(self, agent: str) -> Space:
        """Find the space of the observations of a robot."""
        return self._spaces[agent][0]

    def action_space(self, agent: str) -> Space:
        """Find the space of the actions of a robot."""
        return self._spaces[agent][1]

    def reset(
        self,
        seed: int | None = None,
        options: dict[str, Any] | None = None,  # noqa: ARG002 - of PettingZoo
    ) -> tuple[dict[str, Observations], Infos]:
        """Start a new episode of all robots."""
        if seed is not None:
            self._episodes.seed(seed, np.ones(1, np.bool_))
        self._episodes.restart(np.ones(1, np.bool_))
        self.agents = list(self.possible_agents)
        found = dict(zip(self.agents, self._episodes.observe()[0], strict=True))
        return found, {name: {} for name in self.agents}

    def step(
        self, actions: dict[str, Actions]
    ) -> tuple[dict[str, Observations], dict[str, float], dict[str, bool], dict[str, bool], Infos]:
        """Make a step.

        Raises:
            Invalid: A robot of `agents` has no action, or one of a wrong shape.
        """
        if missing := [name for name in self.agents if name not in actions]:
            raise Invalid(f"robot '{missing[0]}' has no action", hint="give one for all of agents")
        wanted = np.zeros((1, len(self.possible_agents), ACTION_COLUMNS))
        live = self.agents
        for name in live:
            wanted[0, self._rows[name]] = _read_action(name, actions[name])
        found = self._episodes.step(wanted)
        terminated = {name: bool(found.is_over[0, self._rows[name]]) for name in live}
        truncated = {name: bool(found.truncated[0]) and not terminated[name] for name in live}
        self.agents = [name for name in live if not (terminated[name] or truncated[name])]
        rows = self._rows
        return (
            {name: found.observations[0, rows[name]] for name in live},
            {name: float(found.rewards[0, rows[name]]) for name in live},
            terminated,
            truncated,
            {name: {"success": bool(found.is_success[0, rows[name]])} for name in live},
        )

    def close(self) -> None:
        """End the threads."""
        self._episodes.close()


def _read_action(robot: str, given: Actions) -> Actions:
    action = np.asarray(given)
    if action.shape != (ACTION_COLUMNS,):
        raise Invalid(
            f"the action of robot '{robot}' has shape {action.shape}",
            slug="wrong_shape",
            hint=f"use {(ACTION_COLUMNS,)}: v and w",
        )
    return action
