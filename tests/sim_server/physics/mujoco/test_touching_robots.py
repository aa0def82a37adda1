"""Robots that touch: both factorizations of Newton's method give the same accelerations.

MuJoCo 4.0.0 factorized the sparse matrix wrongly (google-deepmind/mujoco#3767).
"""

from collections.abc import Sequence

import numpy as np
import pytest

from tests.engines import STEP_NS
from tests.models import a_state
from zensim.sim_server.description.builtin_models import read_builtin_model
from zensim.sim_server.description.urdf.urdf_parser import read_urdf
from zensim.sim_server.physics.engine import FloatArray
from zensim.sim_server.physics.engine_config import EngineConfig
from zensim.sim_server.physics.mujoco import compiled_model
from zensim.sim_server.physics.mujoco.mjcf import write_mjcf
from zensim.sim_server.physics.mujoco.mujoco_engine import MujocoEngine

STEPS = 200
A_SIDE = 4
PITCH = (0.3, 0.32)
"""Of skid_bots whose sides touch [m]."""
WHEEL_SPEED = 5.0
"""[rad/s]; every second robot drives the other way."""
SPARSE = EngineConfig(STEP_NS)
DENSE = EngineConfig(STEP_NS, compiles_ahead=False)


@pytest.fixture
def dense(monkeypatch: pytest.MonkeyPatch) -> MujocoEngine:
    """Make an engine whose model differs in the kind of its matrices alone."""

    def write_dense(*arguments: object) -> tuple[str, dict[str, bytes]]:
        text, meshes = write_mjcf(*arguments)  # type: ignore[arg-type]
        assert text.count('jacobian="sparse"') == 1
        return text.replace('jacobian="sparse"', 'jacobian="dense"'), meshes

    monkeypatch.setattr(compiled_model, "write_mjcf", write_dense)
    engine = MujocoEngine(DENSE)
    spawn_robots(engine)
    monkeypatch.undo()
    return engine


def spawn_robots(engine: MujocoEngine) -> list[int]:
    model = read_urdf(read_builtin_model("skid_bot"))
    engine.expect([model] * A_SIDE**2)
    bodies = [
        engine.add(model, a_state((PITCH[0] * row, PITCH[1] * column, 0.06)))
        for row in range(A_SIDE)
        for column in range(A_SIDE)
    ]
    wheels = len(model.actuators)
    speeds = np.repeat(np.resize((WHEEL_SPEED, -WHEEL_SPEED), len(bodies)), wheels)
    engine.command(bodies, speeds)
    return bodies


def step(engine: MujocoEngine, bodies: Sequence[int]) -> FloatArray:
    """Advance by one step; return how the velocities changed."""
    before = engine.read(bodies)
    engine.step()
    after = engine.read(bodies)
    return np.concatenate(
        [
            (after.base[:, 7:] - before.base[:, 7:]).ravel(),
            after.joint_velocities - before.joint_velocities,
        ]
    )


def begin_alike(engines: Sequence[MujocoEngine], bodies: Sequence[int]) -> None:
    """Give all engines the states of the first, without its accelerations of the last step."""
    states = engines[0].read(bodies)
    joints = np.stack([states.joint_positions, states.joint_velocities])
    for body, base, (angles, speeds) in zip(
        bodies, states.base, joints.reshape(2, len(bodies), -1).swapaxes(0, 1), strict=True
    ):
        for engine in engines:
            engine.set_state(body, base, angles, speeds)


def test_sparse_and_dense_factorizations_agree_where_robots_touch(dense: MujocoEngine) -> None:
    sparse = MujocoEngine(SPARSE)
    bodies = spawn_robots(sparse)
    differences, touching = [], 0
    for _ in range(STEPS):
        begin_alike((sparse, dense), bodies)
        right, found = step(dense, bodies), step(sparse, bodies)
        differences.append(float(np.abs(found - right).max() / np.abs(right).max()))
        touching += bool(sparse.find_contacts(bodies[0]))
    for engine in (sparse, dense):
        engine.close()

    assert touching > STEPS / 2
    assert max(differences) < 1e-5
