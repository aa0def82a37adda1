"""The robots that a source publishes for are those that a recorder takes from agents."""

from tests.chaos.message_source import make_models
from zensim.recording.fleet_robots import list_robots


def test_odometry_and_transforms_of_robots_come_from_agents() -> None:
    (robot,) = list_robots(make_models(1))

    assert robot.keys == ("box_bot0/odom", "box_bot0/tf")
    assert robot.single_keys == ()
