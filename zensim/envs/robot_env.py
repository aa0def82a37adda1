"""ZensimEnv: one robot that learns, as an environment of Gymnasium."""

from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np
import numpy.typing as npt

from zensim.api.api_errors import Invalid
from zensim.envs.env_settings import find_task, make_settings
from zensim.envs.episodes import Episodes, Observations, Outcome
from zensim.envs.robot_task import RobotTask
from zensim.envs.vector_env import make_spaces

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from zensim.envs.batch import Batch
    from zensim.envs.env_settings import EnvKeywords


class ZensimEnv(gymnasium.Env[Observations, npt.NDArray[np.float32]]):
    """One world with one robot that learns; observations are (d,), actions (2,)."""

    metadata = {"render_modes": []}  # noqa: RUF012 - of Gymnasium

    def __init__(self, task: str | RobotTask = "reach", **options: "Unpack[EnvKeywords]") -> None:
        """Make the world.

        Args:
            task: See `ZensimVectorEnv`.
            options: See `EnvKeywords`.

        Raises:
            Invalid: A setting is not valid, or several robots learn.
            Unsupported: See `Batch`.
        """
        own = find_task(task)
        self._episodes = Episodes(own, make_settings(options, own), 1)
        if len(self._episodes.names) != 1:
            raise Invalid(
                f"{len(self._episodes.names)} robots learn",
                hint="use count=1, ZensimVectorEnv or parallel_env",
            )
        self.observation_space, self.action_space = make_spaces(self._episodes, ())

    @property
    def batch(self) -> "Batch":
        """The world as arrays."""
        return self._episodes.batch

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observations, dict[str, Any]]:
        """Start a new episode."""
        if seed is not None:
            self._episodes.seed(seed, np.ones(1, np.bool_))
            seed = int(seed)  # Gymnasium refuses integers of NumPy
        super().reset(seed=seed, options=options)
        self._episodes.restart(np.ones(1, np.bool_))
        return self._episodes.observe()[0, 0], {}

    def step(
        self, action: npt.NDArray[np.float32]
    ) -> tuple[Observations, float, bool, bool, dict[str, Any]]:
        """Make a step."""
        found = self._episodes.step(np.asarray(action, np.float64).reshape(1, 1, -1))
        return (
            found.observations[0, 0],
            *_list_ends(found),
            {"success": bool(found.is_success[0, 0])},
        )

    def close(self) -> None:
        """End the threads."""
        self._episodes.close()


def _list_ends(found: Outcome) -> tuple[float, bool, bool]:
    return float(found.rewards[0, 0]), bool(found.terminated[0]), bool(found.truncated[0])
