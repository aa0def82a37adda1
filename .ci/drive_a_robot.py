"""Drive a robot for two seconds with what is installed: in process, and on a server."""

import sys

import zensim

SPEED, SECONDS = 0.2, 2.0
LEAST_SHARE = 0.75
"""Of the distance, because it starts from rest."""

for make in (zensim.World, zensim.launch):
    with make() as sim:
        robot = sim.spawn("box_bot", name="r1")
        robot.drive(SPEED, 0.0)
        sim.run_for(SECONDS)
        assert LEAST_SHARE < robot.pose.x / (SPEED * SECONDS) < 1 / LEAST_SHARE, robot.pose
sys.stdout.write(f"Python {sys.version.split()[0]}: a robot drives in process and on a server\n")
