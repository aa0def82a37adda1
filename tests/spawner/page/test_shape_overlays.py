"""Frames and collision shapes."""

import msgspec

from tests.spawner.page.builders import make_models_by_name, make_robot, make_snapshot, make_wall
from zensim.proto.messages.model_messages import Model, Shape
from zensim.spawner.page.render_state import RenderedFleet, list_link_poses, make_fleet, make_frame
from zensim.spawner.page.shape_overlays import COLLISION_RGBA, make_collision_templates


def a_robot() -> Model:
    robot = make_robot()
    ball = Shape("sphere", (0.2, 0.0, 0.0), rgba=(1.0, 1.0, 1.0, 1.0))
    base = msgspec.structs.replace(robot.links[0], collisions=(ball,))
    return msgspec.structs.replace(robot, links=(base, *robot.links[1:]))


def a_fleet(*names: str) -> RenderedFleet:
    kinds = {name: make_wall() if name.startswith("w") else a_robot() for name in names}
    return make_fleet(names, make_models_by_name(kinds))


def test_frames_are_those_of_all_links_of_the_entities() -> None:
    fleet = a_fleet("r1", "w1", "r2")
    frame = make_frame(fleet, make_snapshot(*fleet.names, joints=fleet.joints))

    poses = list_link_poses(fleet, frame, ["r2", "w1"])

    assert sorted(poses[:, :2].tolist()) == [[1.0, 0.0], [2.0, 0.0], [2.0, 0.05]]
    assert list_link_poses(fleet, frame, []).shape == (0, 7)


def test_collision_shapes_replace_the_visuals() -> None:
    fleet = a_fleet("r1", "w1")

    templates = make_collision_templates(fleet)

    base, wheel = templates[fleet.templates["r1"]].links
    assert [(shape.kind, shape.rgba) for shape in base] == [("sphere", COLLISION_RGBA)]
    assert wheel == ()
    assert templates[fleet.templates["w1"]].links == ((),)
    joints = templates[fleet.templates["r1"]].visual_joints
    assert joints == fleet.templates["r1"].visual_joints
