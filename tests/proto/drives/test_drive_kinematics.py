"""Every drive, in floats and in arrays."""

from typing import get_args

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.proto.drives.robots_of_each_drive import DRIVES
from tests.proto.drives.single_drive import SingleDrive
from zensim.proto.drives.array_math import ARRAY_MATH
from zensim.proto.drives.column_math import FLOAT_MATH
from zensim.proto.drives.drive_kinematics import make_drive_kinematics
from zensim.proto.drives.measured_joints import MeasuredJoints
from zensim.proto.messages.drive_messages import Drive

ROBOTS, UPDATES, DT_S = 4, 6, 0.02


def test_robots_of_each_drive_are_tested() -> None:
    assert {type(drive) for drive in DRIVES.values()} == set(get_args(Drive))


@pytest.mark.parametrize("drive", DRIVES.values(), ids=DRIVES)
def test_drive_has_as_many_targets_as_its_actuators_take(drive: Drive) -> None:
    joints = (0.0,) * sum(1 for actuator in drive.actuators if actuator.joint)

    targets = SingleDrive(drive).update(positions=joints, velocities=joints)

    assert targets == (0.0,) * sum(actuator.width for actuator in drive.actuators)


@pytest.mark.parametrize("drive", DRIVES.values(), ids=DRIVES)
@given(seed=st.integers(0, 2**32 - 1))
def test_drive_gives_the_same_targets_in_floats_and_in_arrays(drive: Drive, seed: int) -> None:
    rng = np.random.default_rng(seed)
    joints = sum(1 for actuator in drive.actuators if actuator.joint)
    group, single = (
        make_drive_kinematics(drive, ARRAY_MATH),
        make_drive_kinematics(drive, FLOAT_MATH),
    )
    states = [(0.0,) * single.state_size for _ in range(ROBOTS)]
    group_state = tuple(np.zeros((group.state_size, ROBOTS)))
    for _ in range(UPDATES):
        twists = rng.uniform(-2.0, 2.0, (3, ROBOTS))
        positions, velocities = rng.uniform(-3.0, 3.0, (2, joints, ROBOTS))
        found, group_state = group.find_targets(
            (twists[0], twists[1], twists[2]),
            measured=MeasuredJoints(positions, velocities),
            state=group_state,
            dt_s=np.full(ROBOTS, DT_S),
        )
        for robot in range(ROBOTS):
            vx, vy, wz = twists[:, robot].tolist()
            measured = MeasuredJoints(positions[:, robot].tolist(), velocities[:, robot].tolist())
            targets, states[robot] = single.find_targets(
                (vx, vy, wz), measured=measured, state=states[robot], dt_s=DT_S
            )
            assert [column[robot] for column in found] == pytest.approx(targets, abs=1e-12)
