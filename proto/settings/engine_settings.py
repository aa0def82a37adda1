"""Settings of physics: the engine of a world, and how it shares the work."""

from typing import Annotated, Final, Literal, TypedDict

import msgspec

from zensim.proto.engine_proofs import EngineName
from zensim.proto.settings.setting import Setting

Clustering = Literal["auto", "on", "off"]
WorldDynamics = Literal["full", "kinematic", "auto"]
"""The values of `Dynamics` that are chosen, not left to another place."""


class EngineChoice(msgspec.Struct, frozen=True, kw_only=True):
    """The engine of a world."""

    engine: Annotated[
        EngineName | None,
        Setting(
            help="Physics engine that simulates the world.",
            panel="Physics",
            usual="pybullet if installed",
            variables=("ZENSIM_ENGINE",),
            key="engine.use",
        ),
    ] = None
    allow_failed_engine: Annotated[
        bool,
        Setting(
            help="Use the engine even if it fails a case of its proof.",
            panel="Physics",
            variables=("ZENSIM_ALLOW_FAILED_ENGINE",),
            key="engine.allow_failed",
        ),
    ] = False


USUAL_ENGINE: Final = EngineChoice()
"""The default engine."""


class EngineSettings(EngineChoice, frozen=True, kw_only=True):
    """Physics of a server's worlds."""

    dynamics: Annotated[
        WorldDynamics,
        Setting(
            help="Default motion model of robots; auto = full only where contacts are possible.",
            panel="Physics",
            key="engine.dynamics",
        ),
    ] = "full"
    clusters: Annotated[
        Clustering,
        Setting(
            help="Simulate robots that cannot touch each other in separate clusters; "
            "auto = if there are many robots.",
            panel="Physics",
            key="engine.clusters",
        ),
    ] = "auto"
    engine_workers: Annotated[
        int | None,
        Setting(
            help="Number of extra processes that step clusters.",
            panel="Physics",
            metavar="N",
            least=0,
            usual="CPU cores - 1",
            key="engine.workers",
        ),
    ] = msgspec.field(default=None, name="workers")
    compiles_ahead: bool = True
    """Whether threads compile models that spawns may need next, which saves later steps a delay."""
    cores: int | None = None
    """Cores that the choice of cells assumes; None = those that this process may use."""

    def limit_workers(self, most: int) -> "EngineSettings":
        """Limit the processes besides this one, if their number is chosen."""
        if self.engine_workers is None and most:
            return self
        workers = min(self.engine_workers or 0, most)
        return msgspec.structs.replace(self, engine_workers=workers)


class EngineKeywords(TypedDict, total=False):
    """Physics of a world, as keyword arguments."""

    engine: str
    """`pybullet` or `mujoco`; a `World` has MuJoCo unless it is given, a server PyBullet where that
    is installed."""
    allow_failed_engine: bool
    """Use the engine even if it fails a case of its proof."""
    clusters: Clustering
    """Step bodies that cannot touch in separate cells: auto (in large worlds), on or off."""


ONE_CELL: Final[EngineKeywords] = {"clusters": "off"}
"""Keywords of a world for one robot."""
