"""ZensimVectorEnv: many worlds as a vector environment of Gymnasium."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from zensim.api.api_errors import Invalid
from zensim.api.argument_checks import check_whole
from zensim.envs.batch import MAX_WORLDS
from zensim.envs.env_settings import find_task, make_settings
from zensim.envs.episodes import ACTION_COLUMNS, Episodes, Observations
from zensim.envs.robot_task import RobotTask

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from zensim.envs.batch import Batch
    from zensim.envs.env_settings import EnvKeywords
    from zensim.sim_server.physics.engine import BoolArray, FloatArray

MODES = (AutoresetMode.NEXT_STEP, AutoresetMode.DISABLED)
Infos = dict[str, Any]
Space = spaces.Space[Any]


def make_spaces(episodes: Episodes, shape: tuple[int, ...]) -> tuple[Space, Space]:
    """Make the spaces of observations and actions of `shape` robots."""
    low, high = (np.tile(limit, (*shape, 1)) if shape else limit for limit in episodes.limits)
    actions = spaces.Box(-1.0, 1.0, (*shape, ACTION_COLUMNS), np.float32)
    return spaces.Box(low, high, dtype=np.float32), actions


class ZensimVectorEnv(VectorEnv[Observations, npt.NDArray[Any], npt.NDArray[Any]]):
    """Many worlds in one process; an environment is one world with all its robots.

    Observations are (num_envs, robots, d), actions (num_envs, robots, 2): forward velocity and
    turn, from -1 to 1. The reward of a world is the mean of those of its robots, which are in
    `infos["robot_rewards"]`. An episode ends when those of all robots have ended.
    """

    def __init__(
        self,
        num_envs: int = 16,
        *,
        task: str | RobotTask = "reach",
        autoreset_mode: AutoresetMode = AutoresetMode.NEXT_STEP,
        **options: "Unpack[EnvKeywords]",
    ) -> None:
        """Make the worlds.

        Args:
            num_envs: Number of worlds, 1 to 65536.
            task: `reach`, `avoid`, `formation`, `navigate`, `pursue`, `cover`, `deliver`, or one
                of your own, which is copied.
            autoreset_mode: NEXT_STEP: the step after the end of an episode restarts its world and
                ignores its action. DISABLED: `reset(options={"reset_mask": mask})` does.
            options: See `EnvKeywords`.

        Raises:
            Invalid: A setting is not valid.
            Unsupported: The worlds cannot be copied; see `Batch`.
        """
        check_whole("num_envs", num_envs, 1, MAX_WORLDS)
        if autoreset_mode not in MODES:
            names = " or ".join(mode.name for mode in MODES)
            raise Invalid(f"autoreset mode {autoreset_mode}", hint=f"use {names}")
        own = find_task(task)
        self._episodes = Episodes(own, make_settings(options, own), num_envs)
        self.metadata = {"autoreset_mode": autoreset_mode, "render_modes": []}
        self.num_envs = num_envs
        shape = (len(self._episodes.names),)
        self.single_observation_space, self.single_action_space = make_spaces(self._episodes, shape)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._mode = autoreset_mode
        self._has_ended = np.ones(num_envs, np.bool_)
        self._is_new = True

    @property
    def batch(self) -> "Batch":
        """The worlds as arrays."""
        return self._episodes.batch

    def reset(
        self,
        *,
        seed: int | np.integer[Any] | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Observations, Infos]:
        """Start new episodes.

        Args:
            seed: Of all worlds, or one for each; None = go on with the random numbers.
            options: `reset_mask` (num_envs,) selects worlds; the others go on.

        Raises:
            Invalid: The mask or the number of seeds does not fit, or one is not a whole number.
        """
        chosen = self._read_mask(options or {})
        if isinstance(seed, np.integer):
            seed = int(seed)
        if seed is not None:
            self._seed(seed, chosen)
        if isinstance(seed, int):
            super().reset(seed=seed)
        self._episodes.restart(chosen)
        self._has_ended[chosen] = False
        self._is_new = False
        return self._episodes.observe(), {}

    def step(
        self, actions: npt.NDArray[Any]
    ) -> tuple[Observations, "FloatArray", "BoolArray", "BoolArray", Infos]:
        """Make a step; see the class."""
        ended = self._has_ended
        if ended.any() and (self._is_new or self._mode is AutoresetMode.DISABLED):
            raise Invalid(
                f"the episodes of worlds {np.flatnonzero(ended)[:5].tolist()} have ended",
                slug="not_reset",
                hint='call reset(), or reset(options={"reset_mask": mask})',
            )
        found = self._episodes.step(np.asarray(actions, np.float64), ended)
        self._has_ended = found.terminated | found.truncated
        infos = {
            "robot_rewards": found.rewards,
            "robot_over": found.is_over,
            "robot_success": found.is_success,
        }
        masks = {f"_{name}": np.ones(self.num_envs, np.bool_) for name in infos}
        rewards = found.rewards.mean(axis=1)
        ends = found.terminated, found.truncated
        return found.observations, rewards, *ends, {**infos, **masks}

    def close_extras(self, **kwargs: Any) -> None:  # noqa: ANN401, ARG002 - of Gymnasium
        """End the threads."""
        self._episodes.close()

    def _read_mask(self, options: dict[str, Any]) -> "BoolArray":
        """Read the mask of worlds; all without one, and before the first reset."""
        mask = options.get("reset_mask")
        if mask is None:
            return np.ones(self.num_envs, np.bool_)
        chosen = np.asarray(mask)
        if chosen.shape != (self.num_envs,) or chosen.dtype != np.bool_ or not chosen.any():
            raise Invalid(
                f"reset_mask has shape {chosen.shape} of {chosen.dtype}",
                slug="wrong_shape",
                hint=f"use ({self.num_envs},) of bool, with at least one True",
            )
        if self._is_new:
            raise Invalid("no world has an episode yet", slug="not_reset", hint="call reset()")
        return chosen

    def _seed(self, seed: int | Sequence[int | None], chosen: "BoolArray") -> None:
        """Seed the worlds that are chosen."""
        if not isinstance(seed, Sequence | np.ndarray):
            self._episodes.seed(seed, chosen)
            return
        if len(seed) != self.num_envs:
            raise Invalid(
                f"{len(seed)} seeds for {self.num_envs} worlds", hint="give one, or one for each"
            )
        pairs = zip(seed, chosen.tolist(), strict=True)
        self._episodes.seed_each([one if is_chosen else None for one, is_chosen in pairs])
