"""Trials of MuJoCo's library."""

from collections.abc import Iterator

import mujoco
import numpy as np

from zensim.sim_server.physics.engine import FloatArray
from zensim.sim_server.physics.engine_proof.engine_trials import (
    GRAVITY,
    Held,
    HeldArm,
    Pendulum,
    Ramp,
)

# Warnings would go to the terminal and to a file in the working directory.
mujoco.set_mju_user_warning(lambda _: None)

ROBOTS_A_SIDE, WHEELS = 4, 4
STEPS_OF_ROBOTS = 4
WHEEL_EFFORTS = (0.3, -0.3)
"""[N m] of the wheels of every second robot, which push one another."""
DENSE, SPARSE = int(mujoco.mjtJacobian.mjJAC_DENSE), int(mujoco.mjtJacobian.mjJAC_SPARSE)
STIFFNESS, DAMPING = 2e4, 2e3
"""Gains of the servos of an arm [N m/rad] and [N m s/rad]."""
OPTION = '<option timestep="{}" gravity="{} {} {}" iterations="100" tolerance="1e-12" {}/>'


class MujocoTrials:
    """See `EngineTrials`."""

    def find_accelerations(self) -> tuple[FloatArray, FloatArray]:
        """Compare Newton with a sparse and with a dense Jacobian, of robots that touch.

        MuJoCo 4.0.0 factorized the sparse matrix wrongly (google-deepmind/mujoco#3767).
        """
        model = mujoco.MjModel.from_xml_string(_write_touching_robots())
        data = mujoco.MjData(model)
        per_robot = np.repeat(np.resize(WHEEL_EFFORTS, ROBOTS_A_SIDE**2), WHEELS)
        wheels = np.arange(model.nv).reshape(ROBOTS_A_SIDE**2, -1)[:, -WHEELS:].reshape(-1)
        data.qfrc_applied[wheels] = per_robot
        pairs = []
        for _ in range(STEPS_OF_ROBOTS):
            pairs.append([_solve(model, data, jacobian) for jacobian in (SPARSE, DENSE)])
            mujoco.mj_step(model, data)
        sparse, dense = np.array(pairs).swapaxes(0, 1)
        return sparse, dense

    def slide(self, ramp: Ramp) -> float:
        """See `EngineTrials`."""
        size = " ".join(map(str, ramp.half_extents_m))
        data, steps = _start(
            _write_option(0.002, ramp.gravity, 'cone="elliptic" impratio="100"'),
            f'<geom type="plane" size="9 9 1" friction="{ramp.friction}"/>'
            f'<body pos="0 0 {ramp.half_extents_m[2]}"><freejoint/><geom type="box" size="{size}" '
            f'mass="{ramp.mass_kg}" friction="{ramp.friction}"/></body>',
            round(ramp.duration_s / 0.002),
        )
        speeds = [float(data.qvel[0]) for _ in steps]
        middle = len(speeds) // 2
        return (speeds[-1] - speeds[middle - 1]) / ((len(speeds) - middle) * 0.002)

    def swing(self, pendulum: Pendulum) -> FloatArray:
        """See `EngineTrials`."""
        data, steps = _start(
            _write_option(pendulum.step_s, (0.0, 0.0, -GRAVITY), 'integrator="RK4"'),
            '<body><joint axis="0 1 0"/>'
            + _write_inertial((0.0, 0.0, -pendulum.length_m), pendulum.mass_kg, pendulum.moment)
            + "</body>",
            round(pendulum.duration_s / pendulum.step_s),
        )
        data.qpos[0] = pendulum.amplitude_rad
        return np.array([pendulum.amplitude_rad, *(float(data.qpos[0]) for _ in steps)])

    def hold(self, arm: HeldArm) -> Held:
        """See `EngineTrials`."""
        near, far = (
            _write_inertial((length / 2.0, 0.0, 0.0), mass, arm.moment)
            for length, mass in zip(arm.lengths_m, arm.masses_kg, strict=True)
        )
        servos = "".join(
            f'<position joint="j{n}" kp="{STIFFNESS}" kv="{DAMPING}"/>' for n in (1, 2)
        )
        data, steps = _start(
            _write_option(0.004, (0.0, 0.0, -GRAVITY), 'integrator="implicitfast"'),
            f'<body><joint name="j1" axis="0 1 0"/>{near}<body pos="{arm.lengths_m[0]} 0 0">'
            f'<joint name="j2" axis="0 1 0"/>{far}</body></body>',
            round(arm.duration_s / 0.004),
            f"<actuator>{servos}</actuator>",
        )
        for _ in steps:
            pass
        angles, efforts = data.qpos.tolist(), data.qfrc_actuator.tolist()
        return Held((angles[0], angles[1]), (efforts[0], efforts[1]))


def _solve(model: mujoco.MjModel, data: mujoco.MjData, jacobian: int) -> FloatArray:
    model.opt.jacobian = jacobian
    data.qacc_warmstart[:] = 0.0
    mujoco.mj_forward(model, data)
    return np.array(data.qacc)


def _start(
    option: str, bodies: str, steps: int, rest: str = ""
) -> tuple[mujoco.MjData, Iterator[None]]:
    """Make a world, and what steps it once for each turn of a loop."""
    model = mujoco.MjModel.from_xml_string(
        f"<mujoco>{option}<worldbody>{bodies}</worldbody>{rest}</mujoco>"
    )
    data = mujoco.MjData(model)

    def advance() -> Iterator[None]:
        for _ in range(steps):
            mujoco.mj_step(model, data)
            yield

    return data, advance()


def _write_option(step_s: float, gravity: tuple[float, float, float], rest: str) -> str:
    return OPTION.format(step_s, *gravity, rest)


def _write_inertial(place: tuple[float, float, float], mass: float, moment: float) -> str:
    x, y, z = place
    return (
        f'<inertial pos="{x} {y} {z}" mass="{mass}" diaginertia="{moment} {moment} {moment}"/>'
        '<geom type="sphere" size="0.01" contype="0" conaffinity="0"/>'
    )


def _write_touching_robots() -> str:
    """Write robots with four wheels, side by side and one behind the other, 1 mm into another."""
    wheels = "".join(
        f'<body pos="{x} {y} 0"><joint axis="0 1 0"/>'
        '<geom type="cylinder" size="0.06 0.02" zaxis="0 1 0" mass="0.4"/></body>'
        for x in (0.1, -0.1)
        for y in (0.12, -0.12)
    )
    robots = "".join(
        f'<body pos="{0.299 * row} {0.279 * column} 0.06"><freejoint/>'
        f'<geom type="box" size="0.15 0.1 0.04" pos="0 0 0.03" mass="6"/>{wheels}</body>'
        for row in range(ROBOTS_A_SIDE)
        for column in range(ROBOTS_A_SIDE)
    )
    option = _write_option(0.004, (0.0, 0.0, -GRAVITY), 'cone="elliptic"')
    ground = '<geom type="plane" size="9 9 1"/>'
    return f"<mujoco>{option}<worldbody>{ground}{robots}</worldbody></mujoco>"
