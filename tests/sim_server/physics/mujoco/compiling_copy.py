"""A process that is copied while its thread compiles; the copy prints what it compiles itself."""

import os
import sys
from threading import Event

from tests.engines import STEP_NS
from tests.integration.processes import eventually
from zensim.sim_server.physics.engine_config import EngineConfig
from zensim.sim_server.physics.mujoco.compile_cache import CompileCache
from zensim.sim_server.physics.mujoco.slot_layout import Archetype, SlotCounts

CONFIG = EngineConfig(STEP_NS)
WITHIN_S = 10.0


def compile_slowly(counts: SlotCounts, _config: EngineConfig) -> int:
    """Compile; in the first process this never ends."""
    if os.getpid() == FIRST:
        Event().wait()
    return counts[0][1]


def main(archetype: Archetype) -> None:
    """Start compiling, and let a copy of this process do it."""
    cache = CompileCache(compile_slowly)
    four, eight = (((archetype, slots),) for slots in (4, 8))
    cache.is_ready(four, CONFIG)
    copy = os.fork()
    if copy:
        os._exit(os.waitstatus_to_exitcode(os.waitpid(copy, 0)[1]))
    eventually(lambda: cache.is_ready(eight, CONFIG), WITHIN_S, "compilation")
    sys.stdout.write(f"{cache.compile(four, CONFIG)} {cache.compile(eight, CONFIG)}")
    sys.stdout.flush()
    os._exit(0)


if __name__ == "__main__":
    FIRST = os.getpid()
    main(Archetype((), (), is_static=False))
