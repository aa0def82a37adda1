"""Trials of Bullet's library."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import numpy as np

from zensim.sim_server.physics.bullet.muted_output import suppress_output
from zensim.sim_server.physics.engine import FloatArray
from zensim.sim_server.physics.engine_proof.engine_trials import (
    GRAVITY,
    Held,
    HeldArm,
    Pendulum,
    Ramp,
)

with suppress_output():
    import pybullet

Vector = tuple[float, float, float]
UPRIGHT = (0.0, 0.0, 0.0, 1.0)
ITERATIONS = 200
RANDOM_STATES = 5
"""States in which accelerations are compared."""
SHORT_STEP_S = 1e-5
STEP_S = 1.0 / 250.0
EFFORT = 100.0
"""Limit of the motors of an arm [N m]."""


class BulletTrials:
    """See `EngineTrials`."""

    def find_accelerations(self) -> tuple[FloatArray, FloatArray]:
        """Compare a step (articulated bodies) with mass matrix and inverse dynamics, of an arm."""
        random = np.random.default_rng(0)
        pairs = []
        with _connected((0.0, 0.0, -GRAVITY), SHORT_STEP_S) as client:
            arm = _make_chain(
                client,
                ((0.0, 0.0, 0.0), (0.5, 0.0, 0.0), (0.4, 0.0, 0.0)),
                centres=((0.25, 0.0, 0.02), (0.2, 0.03, 0.0), (0.15, 0.0, 0.0)),
                axes=((0.0, 1.0, 0.0), (0.0, 1.0, 0.0), (1.0, 0.0, 0.0)),
                masses=(2.0, 1.5, 1.0),
                moments=((0.02, 0.05, 0.05), (0.01, 0.03, 0.03), (0.01, 0.02, 0.02)),
            )
            for _ in range(RANDOM_STATES):
                angles, speeds, efforts = random.uniform(-1.0, 1.0, (3, 3)).tolist()
                stepped = _accelerate(client, arm, angles, speeds, efforts)
                matrix = pybullet.calculateMassMatrix(arm, angles, physicsClientId=client)
                bias = pybullet.calculateInverseDynamics(
                    arm, angles, speeds, [0.0] * 3, physicsClientId=client
                )
                solved = np.linalg.solve(np.array(matrix), np.subtract(efforts, bias))
                pairs.append((stepped, solved))
        return np.array([one[0] for one in pairs]), np.array([one[1] for one in pairs])

    def slide(self, ramp: Ramp) -> float:
        """See `EngineTrials`."""
        with _connected(ramp.gravity, STEP_S) as client:
            plane = pybullet.createCollisionShape(pybullet.GEOM_PLANE, physicsClientId=client)
            ground = pybullet.createMultiBody(0.0, plane, physicsClientId=client)
            box = pybullet.createCollisionShape(
                pybullet.GEOM_BOX, halfExtents=ramp.half_extents_m, physicsClientId=client
            )
            height = ramp.half_extents_m[2]
            block = pybullet.createMultiBody(
                ramp.mass_kg, box, basePosition=(0.0, 0.0, height), physicsClientId=client
            )
            for body, friction in ((ground, 1.0), (block, ramp.friction)):
                pybullet.changeDynamics(
                    *(body, -1),
                    lateralFriction=friction,
                    linearDamping=0.0,
                    angularDamping=0.0,
                    physicsClientId=client,
                )
            speeds = []
            for _ in range(round(ramp.duration_s / STEP_S)):
                pybullet.stepSimulation(physicsClientId=client)
                speeds.append(pybullet.getBaseVelocity(block, physicsClientId=client)[0][0])
        middle = len(speeds) // 2
        return (speeds[-1] - speeds[middle - 1]) / ((len(speeds) - middle) * STEP_S)

    def swing(self, pendulum: Pendulum) -> FloatArray:
        """See `EngineTrials`."""
        angles = [pendulum.amplitude_rad]
        with _connected((0.0, 0.0, -GRAVITY), pendulum.step_s) as client:
            body = _make_chain(
                client,
                ((0.0, 0.0, 0.0),),
                centres=((0.0, 0.0, -pendulum.length_m),),
                axes=((0.0, 1.0, 0.0),),
                masses=(pendulum.mass_kg,),
                moments=((pendulum.moment,) * 3,),
            )
            pybullet.resetJointState(body, 0, pendulum.amplitude_rad, physicsClientId=client)
            for _ in range(round(pendulum.duration_s / pendulum.step_s)):
                pybullet.stepSimulation(physicsClientId=client)
                angles.append(pybullet.getJointStates(body, [0], physicsClientId=client)[0][0])
        return np.array(angles)

    def hold(self, arm: HeldArm) -> Held:
        """See `EngineTrials`."""
        near, far = arm.lengths_m
        with _connected((0.0, 0.0, -GRAVITY), STEP_S) as client:
            body = _make_chain(
                client,
                ((0.0, 0.0, 0.0), (near, 0.0, 0.0)),
                centres=((near / 2.0, 0.0, 0.0), (far / 2.0, 0.0, 0.0)),
                axes=((0.0, 1.0, 0.0),) * 2,
                masses=arm.masses_kg,
                moments=((arm.moment,) * 3,) * 2,
            )
            pybullet.setJointMotorControlArray(
                *(body, [0, 1], pybullet.POSITION_CONTROL),
                targetPositions=[0.0, 0.0],
                forces=[EFFORT, EFFORT],
                physicsClientId=client,
            )
            for _ in range(round(arm.duration_s / STEP_S)):
                pybullet.stepSimulation(physicsClientId=client)
            first, second = pybullet.getJointStates(body, [0, 1], physicsClientId=client)
        return Held((first[0], second[0]), (first[3], second[3]))


@contextmanager
def _connected(gravity: Vector, step_s: float) -> Iterator[int]:
    """Connect to a world of its own."""
    client = pybullet.connect(pybullet.DIRECT)
    try:
        pybullet.setGravity(*gravity, physicsClientId=client)
        pybullet.setTimeStep(step_s, physicsClientId=client)
        pybullet.setPhysicsEngineParameter(numSolverIterations=ITERATIONS, physicsClientId=client)
        yield client
    finally:
        pybullet.disconnect(client)


def _make_chain(
    client: int,
    places: Sequence[Vector],
    *,
    centres: Sequence[Vector],
    axes: Sequence[Vector],
    masses: Sequence[float],
    moments: Sequence[Vector],
) -> int:
    """Make links on hinges without motors, one behind the other, the first fixed to the world."""
    count = len(places)
    body = pybullet.createMultiBody(
        0.0,
        linkMasses=masses,
        linkCollisionShapeIndices=[-1] * count,
        linkVisualShapeIndices=[-1] * count,
        linkPositions=places,
        linkOrientations=[UPRIGHT] * count,
        linkInertialFramePositions=centres,
        linkInertialFrameOrientations=[UPRIGHT] * count,
        linkParentIndices=range(count),
        linkJointTypes=[pybullet.JOINT_REVOLUTE] * count,
        linkJointAxis=axes,
        physicsClientId=client,
    )
    for link, moment in enumerate(moments):
        pybullet.changeDynamics(
            *(body, link),
            localInertiaDiagonal=moment,
            linearDamping=0.0,
            angularDamping=0.0,
            jointDamping=0.0,
            physicsClientId=client,
        )
    pybullet.setJointMotorControlArray(
        *(body, list(range(count)), pybullet.VELOCITY_CONTROL),
        forces=[0.0] * count,
        physicsClientId=client,
    )
    return body


def _accelerate(
    client: int,
    arm: int,
    angles: Sequence[float],
    speeds: Sequence[float],
    efforts: Sequence[float],
) -> FloatArray:
    """Find the accelerations of the joints from a short step."""
    for joint, (angle, speed) in enumerate(zip(angles, speeds, strict=True)):
        pybullet.resetJointState(arm, joint, angle, speed, physicsClientId=client)
    joints = list(range(len(angles)))
    pybullet.setJointMotorControlArray(
        arm, joints, pybullet.TORQUE_CONTROL, forces=efforts, physicsClientId=client
    )
    pybullet.stepSimulation(physicsClientId=client)
    states = pybullet.getJointStates(arm, joints, physicsClientId=client)
    return np.subtract([state[1] for state in states], speeds) / SHORT_STEP_S
