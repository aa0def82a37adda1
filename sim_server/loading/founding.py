"""Making the physics of a world that is put in the place of another."""

from __future__ import annotations

from typing import TYPE_CHECKING

from zensim.proto.messages.result_messages import ResultCode
from zensim.sim_server.config import ConfigError, paced
from zensim.sim_server.desk import Founded
from zensim.sim_server.errors import Refused
from zensim.sim_server.loading.world_files import furnishing
from zensim.sim_server.world.world import World

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from zensim.sim_server.config import ServerConfig
    from zensim.sim_server.description.sdf.sdf_world import WorldModel
    from zensim.sim_server.desk import Founding
    from zensim.sim_server.physics.engine import Engine


def founding(
    config: ServerConfig, make_engine: Callable[[ServerConfig, WorldModel], Engine]
) -> Founding:
    """Make worlds as this server makes them: what its start did not fix, each world chooses."""
    asked = config.asked or config

    def found(model: WorldModel) -> Iterator[Founded | None]:
        pace = model.pace
        chosen = paced(asked, step_s=pace.step_s, real_time_factor=pace.real_time_factor)
        world = World(
            make_engine(chosen, model),
            name=chosen.world,
            step_ns=chosen.step_ns,
            control_steps=chosen.control_steps,
        )
        is_whole = False
        try:
            yield from furnishing(world, model)
            is_whole = True
        except ConfigError as error:
            raise Refused(ResultCode.OPERATION_FAILED, str(error)) from error
        finally:
            if not is_whole:
                world.close()
        yield Founded(world, chosen.real_time_factor or 0.0)

    return found
