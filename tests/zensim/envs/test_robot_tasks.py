"""Tasks: observations and rewards, worked out by hand."""

import numpy as np
import pytest

import zensim
from zensim.envs import ZensimVectorEnv
from zensim.envs.avoidance_task import AvoidEachOther
from zensim.envs.formation_task import FollowFormation
from zensim.envs.reaching_task import ReachGoal
from zensim.envs.robot_task import FleetView, Judgement, RobotTask
from zensim.envs.world_streams import WorldStreams

Rows = list[tuple[float, float, float]]


def view(poses: Rows, *, touching: tuple[int, ...] = (), speeds: float = 0.0) -> FleetView:
    """One world."""
    found = np.array([poses])
    is_touching = np.zeros((1, len(poses)), np.bool_)
    is_touching[0, list(touching)] = True
    velocities = np.zeros((1, len(poses), 2))
    velocities[..., 0] = speeds
    return FleetView(found, velocities, is_touching, np.zeros(1))


def start(task: RobotTask, poses: Rows) -> np.ndarray:
    first = view(poses)
    task.restart(np.arange(1), first, WorldStreams(1))
    return np.asarray(task.observe(first)[0])


def test_goal_is_seen_in_the_frame_of_the_robot_within_its_distances() -> None:
    task = ReachGoal(distance_m=(1.0, 2.0))
    seen = start(task, [(3.0, 4.0, 0.0)])[0]

    turned = task.observe(view([(3.0, 4.0, np.pi / 2.0)], speeds=0.3))[0, 0]

    assert 1.0 <= np.hypot(*seen[:2]) <= 2.0
    assert turned == pytest.approx([seen[1], -seen[0], 0.3, 0.0])


def test_reaching_pays_metres_and_the_goal() -> None:
    task = ReachGoal(tolerance_m=0.2)
    x, y = start(task, [(0.0, 0.0, 0.0)])[0, :2]

    half = task.judge(view([(x / 2.0, y / 2.0, 0.0)]))
    there = task.judge(view([(x, y, 0.0)]))

    distance = np.hypot(x, y)
    assert half.rewards[0, 0] == pytest.approx(distance / 2.0 - 0.01)
    assert not half.is_success[0, 0]
    assert there.rewards[0, 0] == pytest.approx(distance / 2.0 - 0.01 + 1.0)
    assert there.is_success[0, 0]


def test_collision_costs_and_ends_reaching() -> None:
    task = ReachGoal()
    start(task, [(0.0, 0.0, 0.0)])

    found = task.judge(view([(0.0, 0.0, 0.0)], touching=(0,)))

    assert found.rewards[0, 0] == pytest.approx(-1.01)
    assert found.is_failure[0, 0]


def test_robots_exchange_places_and_see_each_other() -> None:
    task = AvoidEachOther()
    poses = [(0.0, 0.0, 0.0), (2.0, 0.0, np.pi)]

    seen = start(task, poses)

    assert seen[0, :8] == pytest.approx([2.0, 0.0, 0.0, 0.0, 2.0, 0.0, 0.0, 0.0])
    assert seen[1, :8] == pytest.approx([2.0, 0.0, 0.0, 0.0, 2.0, 0.0, 0.0, 0.0], abs=1e-12)
    assert seen[0, 8:].tolist() == [20.0, 0.0, 0.0, 0.0] * 2
    moving = task.observe(view(poses, speeds=0.5))[0]
    assert moving[0, 6:8] == pytest.approx([-0.5, 0.0])


def test_touching_robots_fail_even_at_their_goals() -> None:
    task = AvoidEachOther()
    start(task, [(0.0, 0.0, 0.0), (2.0, 0.0, 0.0)])

    found = task.judge(view([(2.0, 0.0, 0.0), (2.0, 0.1, 0.0)], touching=(0, 1)))

    assert found.rewards[0] == pytest.approx([0.99, 2.0 - np.hypot(2.0, 0.1) - 2.01])
    assert found.is_failure[0].tolist() == [True, True]
    assert not found.is_success.any()


def test_formation_pays_by_the_error_of_the_place() -> None:
    task = FollowFormation()
    seen = start(task, [(0.0, 0.0, 0.0), (-1.0, 1.0, 0.0)])

    turned = view([(0.0, 0.0, np.pi / 2.0), (-1.0, -0.75, np.pi / 2.0)])
    far = task.judge(view([(5.0, 0.0, 0.0), (-1.0, 1.0, 0.0)]))

    assert seen[0] == pytest.approx([0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    assert task.observe(turned)[0, 0, :2] == pytest.approx([-0.25, 0.0], abs=1e-12)
    assert task.judge(turned).rewards[0, 0] == pytest.approx(0.5)
    assert far.is_failure[0, 0]
    assert far.rewards[0, 0] == 0.0


def test_leader_drives_ahead_and_followers_learn() -> None:
    task = FollowFormation(speed_m_s=0.25)
    poses = [(0.0, 0.0, 0.0), (-1.0, 1.0, 0.0), (-1.0, -1.0, 0.0)]
    start(task, poses)

    assert task.choose_agents(3).tolist() == [1, 2]
    assert task.drive(view(poses))[0, :, 0].tolist() == [0.25, 0.0, 0.0]


class WrongTask(ReachGoal):
    """Returns from one of its methods something else."""

    def __init__(self, method: str, found: object) -> None:
        super().__init__()
        setattr(self, method, lambda _: found)


WRONG = [
    ("choose_agents", np.array([0, 5])),
    ("choose_agents", np.array([0, 0])),
    ("choose_agents", np.array([True, False])),
    ("choose_agents", np.zeros(0, np.intp)),
    ("list_bounds", np.ones((2, 2))),
    ("observe", np.zeros((3, 4))),
    ("observe", np.zeros((3, 2, 5))),
    ("observe", [[0.0]]),
    ("observe", np.full((3, 2, 4), np.nan)),
    ("judge", None),
    ("judge", Judgement(np.zeros(3), np.zeros((3, 2), np.bool_), np.zeros((3, 2), np.bool_))),
    ("judge", Judgement(np.zeros((3, 2)), np.zeros((3, 2)), np.zeros((3, 2), np.bool_))),  # type: ignore[arg-type]
    ("judge", Judgement(np.full((3, 2), np.nan), *[np.zeros((3, 2), np.bool_)] * 2)),
]


@pytest.mark.parametrize(("method", "found"), WRONG)
def test_task_that_returns_something_else_is_named(method: str, found: object) -> None:
    def make_step() -> None:
        env = ZensimVectorEnv(3, task=WrongTask(method, found), count=2, threads=1)
        env.reset(seed=1)
        env.step(np.zeros((3, 2, 2)))

    with pytest.raises(zensim.Invalid) as refused:
        make_step()

    assert f"WrongTask.{method}()" in str(refused.value)
