"""The floor of a fleet: box_bots in a plain PyBullet loop, best settings, no server, no network.

The bodies are the server's own, with fixed links lumped: PyBullet's own parser keeps them apart and
steps 1.4 times as long.
"""

import time
from dataclasses import dataclass

import numpy as np
import pybullet

from benchmarks.bodies import standing_at
from benchmarks.circling_driver import WHEEL_SPEEDS
from benchmarks.ten_robots import SPACING_M
from tests.sim_server.physics.bullet_probe import client_of, unique_id_of
from zensim.sim_server.description.builtin_models import read_builtin_model
from zensim.sim_server.description.urdf.urdf_parser import read_urdf
from zensim.sim_server.physics.bullet.bullet_contact import SOLVER_ITERATIONS
from zensim.sim_server.physics.bullet.pybullet_engine import PyBulletEngine
from zensim.sim_server.physics.engine_config import EngineConfig
from zensim.spawner.spawn.spawn_poses import make_fleet_layout

FEW_ITERATIONS = 10
"""Minimum solver iterations for accurate driving of box_bots."""
WHEEL_EFFORTS = (0.1, 0.1)


@dataclass(frozen=True)
class Turn:
    """A number of steps, and their cost."""

    steps: int
    wall_s: float
    cpu_s: float
    """CPU time of the loop's thread."""


class PlainLoop:
    """Box_bots on a grid, driving circles, commanded and read at each control period."""

    def __init__(self, count: int, *, step_ns: int, control_steps: int) -> None:
        self._engine = PyBulletEngine(EngineConfig(step_ns))
        self._client = client_of(self._engine)
        self._control_steps = control_steps
        model = read_urdf(read_builtin_model("box_bot"))
        bodies = []
        for place in make_fleet_layout("box_bot", count, "grid", SPACING_M):
            base = standing_at(place.x)
            base[1] = place.y
            bodies.append(self._engine.add(model, base))
        # Commanded through the engine, which releases the rolling resistance of robots at rest.
        self._engine.command(bodies, np.tile(WHEEL_SPEEDS, count))
        self._bodies = [unique_id_of(self._engine, body) for body in bodies]
        self._wheels = [self._moving(body) for body in self._bodies]

    def turn(self, least_s: float, iterations: int = FEW_ITERATIONS) -> Turn:
        """Advance by whole control periods, with a maximum number of solver iterations."""
        pybullet.setPhysicsEngineParameter(
            numSolverIterations=iterations, physicsClientId=self._client
        )
        steps, start_s, start_cpu_s = 0, time.perf_counter(), time.thread_time()
        while (wall_s := time.perf_counter() - start_s) < least_s:
            self._drive()
            for _ in range(self._control_steps):
                pybullet.stepSimulation(physicsClientId=self._client)
            self._read()
            steps += self._control_steps
        return Turn(steps, wall_s, time.thread_time() - start_cpu_s)

    def turn_as_served(self, least_s: float) -> Turn:
        """Advance with the settings of the server."""
        return self.turn(least_s, SOLVER_ITERATIONS)

    def speeds(self) -> list[float]:
        """Get the speed of each robot [m/s]."""
        velocities = [
            pybullet.getBaseVelocity(body, physicsClientId=self._client)[0] for body in self._bodies
        ]
        return [float((x * x + y * y) ** 0.5) for x, y, _ in velocities]

    def close(self) -> None:
        """Free the engine."""
        self._engine.close()

    def _moving(self, body: int) -> list[int]:
        joints = range(pybullet.getNumJoints(body, physicsClientId=self._client))
        return [
            joint
            for joint in joints
            if pybullet.getJointInfo(body, joint, physicsClientId=self._client)[2]
            == pybullet.JOINT_REVOLUTE
        ]

    def _drive(self) -> None:
        for body, wheels in zip(self._bodies, self._wheels, strict=True):
            pybullet.setJointMotorControlArray(
                body,
                wheels,
                pybullet.VELOCITY_CONTROL,
                targetVelocities=WHEEL_SPEEDS,
                forces=WHEEL_EFFORTS,
                physicsClientId=self._client,
            )

    def _read(self) -> None:
        client = self._client
        for body, wheels in zip(self._bodies, self._wheels, strict=True):
            pybullet.getBasePositionAndOrientation(body, physicsClientId=client)
            pybullet.getBaseVelocity(body, physicsClientId=client)
            pybullet.getJointStates(body, wheels, physicsClientId=client)
