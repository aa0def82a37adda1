"""Motions and targets of a group have the same bits however its robots are divided among groups."""

import numpy as np
import pytest

from tests.proto.drives.robots_of_each_drive import DRIVES, robot_of
from tests.robot_agent.models import a_claim
from zensim.proto.messages.agent_messages import STATE_COLUMNS
from zensim.proto.messages.drive_messages import Drive
from zensim.robot_agent.pool.group_bases import GroupBaseController, GroupDrive
from zensim.robot_agent.pool.group_key import GroupKey, make_group_key
from zensim.robot_agent.robot_rows import FloatArray, StateRows
from zensim.robot_agent.topic_remapping import find_topic_keys

ROBOTS = 17
"""More than any vector of numbers, and no multiple of one."""
STEP_NS = 12_500_000


def drive_group(
    group_key: GroupKey, states: list[StateRows], twists: FloatArray, part: slice
) -> bytes:
    """Drive a part of the robots through states; return the bits of their targets and motions."""
    bases, found = GroupBaseController(group_key), b""
    rows = np.arange(ROBOTS)[part]
    bases.remap(np.full(len(rows), -1))
    for state in states:
        columns = (state.base[part], state.positions[part], state.velocities[part])
        bases.update(StateRows(state.time_ns, *columns), twists[part])
        found = np.hstack([bases.targets, bases.find_motions(np.arange(len(rows)))]).tobytes()
    return found


@pytest.mark.parametrize("drive", DRIVES.values(), ids=DRIVES)
@pytest.mark.parametrize("size", [1, 2, 3, 4, 5, 7, 8, 16])
def test_robots_divided_anyhow_have_equal_bits(drive: Drive, size: int) -> None:
    claim = a_claim(1, "r1", robot_of(drive))
    group_key, rng = make_group_key(claim, find_topic_keys(claim)), np.random.default_rng(size)
    joints = group_key.joint_count
    states = []
    for step in range(1, 4):
        base = rng.normal(size=(ROBOTS, STATE_COLUMNS))
        base[:, 3:7] /= np.linalg.norm(base[:, 3:7], axis=1, keepdims=True)
        wheels = rng.normal(size=(2, ROBOTS, joints))
        states.append(StateRows(step * STEP_NS, base, *wheels))
    twists = rng.normal(size=(ROBOTS, 6))

    whole = drive_group(group_key, states, twists, slice(None))
    parts = [slice(start, start + size) for start in range(0, ROBOTS, size)]

    assert b"".join(drive_group(group_key, states, twists, part) for part in parts) == whole


def test_updates_of_robots_that_joined_in_an_earlier_row_are_repeated_in_their_own_rows() -> None:
    drive, twists = GroupDrive(DRIVES["diff, slow to speed up"]), np.zeros((2, 6))
    measured = np.zeros((1, 2))
    drive.remap(np.array([-1]))
    drive.begin(STEP_NS)
    for rows, before in (([0], [0]), ([0], [-1, 0])):
        drive.remap(np.array(before))
        drive.update(
            np.array(rows),
            twists[:1],
            positions=measured,
            velocities=measured,
            elapsed_s=np.array([0.02]),
        )
    twists[:, 0] = (0.1, 0.2)

    drive.revise(twists)

    assert drive.save()[:, 0].tolist() == [0.1, 0.2]
