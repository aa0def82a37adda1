"""Drive a robot for two seconds with each engine: in process, and on a server.

An engine that has a wheel for this Python must be installed.
"""

import sys
from typing import get_args

import zensim
from zensim.proto.engine_proofs import EngineName
from zensim.sim_server.physics.engine_config import has_wheel

SPEED, SECONDS = 0.2, 2.0
LEAST_SHARE = 0.75
"""Of the distance, because it starts from rest."""

engines = [name for name in get_args(EngineName) if has_wheel(name)]
for engine in engines:
    for make in (zensim.World, zensim.launch):
        with make(engine=engine) as sim:
            robot = sim.spawn("box_bot", name="r1")
            robot.drive(SPEED, 0.0)
            sim.run_for(SECONDS)
            assert LEAST_SHARE < robot.pose.x / (SPEED * SECONDS) < 1 / LEAST_SHARE, robot.pose
python = sys.version.split()[0]
sys.stdout.write(
    f"Python {python}: a robot drives in process and on a server with {' and '.join(engines)}\n"
)
