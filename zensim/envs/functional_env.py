"""FunctionalEnv: steps of many worlds as a function of state and actions."""

from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from zensim.api.api_errors import Unsupported
from zensim.api.argument_checks import check_whole
from zensim.api.closed_on_exit import ClosedOnExit
from zensim.envs.batch import MAX_WORLDS
from zensim.envs.env_settings import find_task, make_settings
from zensim.envs.episodes import Episodes, EpisodesState, Observations, Outcome
from zensim.envs.robot_task import RobotTask

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from zensim.envs.env_settings import EnvKeywords
    from zensim.sim_server.physics.engine import BoolArray


class FunctionalEnv(ClosedOnExit):
    """Many worlds of kinematic robots, for loops and searches of your own.

    Nothing is changed by a step: a state can be stepped again, with other actions.
    """

    def __init__(
        self, worlds: int, *, task: str | RobotTask = "reach", **options: "Unpack[EnvKeywords]"
    ) -> None:
        """Make the worlds.

        Args:
            worlds: Their number, 1 to 65536.
            task: See `ZensimVectorEnv`.
            options: See `EnvKeywords`; dynamics are kinematic, and no imu is measured.

        Raises:
            Invalid: A setting is not valid.
            Unsupported: See `Batch.save`.
        """
        check_whole("worlds", worlds, 1, MAX_WORLDS)
        own = find_task(task)
        self._episodes = Episodes(own, make_settings(options, own), worlds)
        self._everything: BoolArray = np.ones(worlds, np.bool_)
        self._state: EpisodesState | None = None
        """State in which the worlds are; None = they are in none that was returned."""
        try:
            self._episodes.batch.save()
        except Unsupported:
            self.close()
            raise

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the robots that learn."""
        return self._episodes.names

    def reset(self, seed: int) -> tuple[EpisodesState, Observations]:
        """Start episodes in all worlds; return the state and observations (worlds, agents, d)."""
        self._episodes.seed(seed, self._everything)
        self._episodes.restart(self._everything)
        observations = self._episodes.observe()
        self._state = self._episodes.save()
        return self._state, observations

    def step(
        self, state: EpisodesState, actions: npt.ArrayLike, restarted: "BoolArray | None" = None
    ) -> tuple[EpisodesState, Outcome]:
        """Find what follows a state.

        Args:
            state: Of this environment, or of another with the same settings.
            actions: (worlds, agents, 2): forward velocity and turn, from -1 to 1.
            restarted: Worlds (worlds,) that start new episodes instead.

        Raises:
            Invalid: A shape is wrong, or an action is not finite.
        """
        if state is not self._state:
            self._episodes.load(state)
        self._state = None
        outcome = self._episodes.step(np.asarray(actions, np.float64), restarted)
        self._state = self._episodes.save()
        return self._state, outcome

    def close(self) -> None:
        """End the threads."""
        self._episodes.close()
