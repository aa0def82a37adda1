"""Making the physics of a world that is put in the place of another."""

from __future__ import annotations

from typing import TYPE_CHECKING

from zensim.proto.messages.result_messages import ResultCode
from zensim.sim_server.errors import RequestRefused
from zensim.sim_server.loading.world_files import furnishing
from zensim.sim_server.server_config import ConfigError, fill_pace
from zensim.sim_server.server_context import BuiltWorld
from zensim.sim_server.world.world import World

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from zensim.sim_server.description.sdf.sdf_world import WorldModel
    from zensim.sim_server.physics.engine import Engine
    from zensim.sim_server.server_config import ServerConfig
    from zensim.sim_server.server_context import WorldFactory


def founding(
    config: ServerConfig, make_engine: Callable[[ServerConfig, WorldModel], Engine]
) -> WorldFactory:
    """Make worlds as this server makes them: what its start did not fix, each world chooses."""
    asked = config.asked or config

    def found(model: WorldModel) -> Iterator[BuiltWorld | None]:
        pace = model.pace
        chosen = fill_pace(asked, step_s=pace.step_s, real_time_factor=pace.real_time_factor)
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
            raise RequestRefused(ResultCode.OPERATION_FAILED, str(error)) from error
        finally:
            if not is_whole:
                world.close()
        yield BuiltWorld(world, chosen.real_time_factor or 0.0)

    return found
