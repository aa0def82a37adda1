"""Many equal worlds in one process, and environments of Gymnasium and PettingZoo on them."""

from importlib import import_module
from importlib.util import find_spec
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from zensim.envs.avoidance_task import AvoidEachOther
    from zensim.envs.batch import Batch
    from zensim.envs.coverage_task import CoverField
    from zensim.envs.env_settings import EnvKeywords, EnvSettings
    from zensim.envs.fleet_env import ZensimParallelEnv, parallel_env
    from zensim.envs.formation_task import FollowFormation
    from zensim.envs.functional_env import FunctionalEnv
    from zensim.envs.navigation_task import DeliverGoods, NavigateMaze
    from zensim.envs.pursuit_task import CatchEvader
    from zensim.envs.reaching_task import ReachGoal
    from zensim.envs.robot_env import ZensimEnv
    from zensim.envs.robot_task import FleetView, RobotTask
    from zensim.envs.trained_policy import Policy, load_baseline
    from zensim.envs.vector_env import ZensimVectorEnv
    from zensim.envs.world_streams import WorldStreams

__all__ = [
    "AvoidEachOther",
    "Batch",
    "CatchEvader",
    "CoverField",
    "DeliverGoods",
    "EnvKeywords",
    "EnvSettings",
    "FleetView",
    "FollowFormation",
    "FunctionalEnv",
    "NavigateMaze",
    "Policy",
    "ReachGoal",
    "RobotTask",
    "WorldStreams",
    "ZensimEnv",
    "ZensimParallelEnv",
    "ZensimVectorEnv",
    "load_baseline",
    "parallel_env",
]
MODULES = {
    "functional_env": ("FunctionalEnv",),
    "world_streams": ("WorldStreams",),
    "navigation_task": ("DeliverGoods", "NavigateMaze"),
    "coverage_task": ("CoverField",),
    "pursuit_task": ("CatchEvader",),
    "avoidance_task": ("AvoidEachOther",),
    "batch": ("Batch",),
    "env_settings": ("EnvKeywords", "EnvSettings"),
    "fleet_env": ("ZensimParallelEnv", "parallel_env"),
    "formation_task": ("FollowFormation",),
    "reaching_task": ("ReachGoal",),
    "robot_env": ("ZensimEnv",),
    "robot_task": ("FleetView", "RobotTask"),
    "trained_policy": ("Policy", "load_baseline"),
    "vector_env": ("ZensimVectorEnv",),
}
"""Names by module, which is imported when the first of them is used."""
_MODULE_OF = {name: module for module, names in MODULES.items() for name in names}


def __getattr__(name: str) -> object:
    """Import a public name when it is first used.

    Raises:
        AttributeError: It is no public name.
        ModuleNotFoundError: It needs an extra that is not installed.
    """
    if (module := _MODULE_OF.get(name)) is None:
        raise AttributeError(f"module 'zensim.envs' has no attribute {name!r}")
    try:
        return getattr(import_module(f"zensim.envs.{module}"), name)
    except ModuleNotFoundError as error:
        if (error.name or "zensim").startswith("zensim"):
            raise
        raise ModuleNotFoundError(
            f"zensim.envs.{name} needs {error.name}, which is not installed; use "
            "pip install 'zensim[server,rl]'",
            name=error.name,
        ) from error


def __dir__() -> list[str]:
    return sorted(__all__)


if find_spec("gymnasium") is not None:
    import_module("zensim.envs.gymnasium_ids").register_ids()
