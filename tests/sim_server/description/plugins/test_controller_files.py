"""Controllers in parameter files of ROS 2 and ROS 1."""

import pytest

from zensim.sim_server.description.plugins.controller_files import (
    MAX_YAML_BYTES,
    MAX_YAML_DEPTH,
    MAX_YAML_NODES,
    Controller,
    read_controllers,
)
from zensim.sim_server.errors import ModelError

DIFF = "diff_drive_controller/DiffDriveController"
PLAIN = f"""
controller_manager:
  ros__parameters:
    update_rate: 50
    base:
      type: {DIFF}
base:
  ros__parameters:
    left_wheel_names: [a, "b"]
    linear.x.max_velocity: 1.0
    linear:
      x: {{min_velocity: -0.5}}
"""
NESTED = f"""
/**:
  controller_manager:
    ros__parameters:
      update_rate: 50
      base.type: {DIFF}
  base:
    ros__parameters:
      left_wheel_names: ['a', 'b']
      linear.x.max_velocity: 1.0
      linear.x.min_velocity: -0.5
"""
SLASHES = f"""
/robot/controller_manager:
  ros__parameters: {{update_rate: 50, base: {{type: {DIFF}}}}}
/robot/base:
  ros__parameters:
    left_wheel_names: [a, b]
    linear.x.max_velocity: 1.0
    linear.x.min_velocity: -0.5
"""
OWN_TYPE = f"""
controller_manager:
  ros__parameters:
    update_rate: 50
base:
  ros__parameters:
    type: {DIFF}
    left_wheel_names: [a, b]
    linear.x.max_velocity: 1.0
    linear.x.min_velocity: -0.5
"""
INSIDE_MANAGER = f"""
controller_manager:
  ros__parameters:
    update_rate: 50
    base:
      type: {DIFF}
      left_wheel_names: [a, b]
      linear.x.max_velocity: 1.0
      linear.x.min_velocity: -0.5
"""
FOUND = {
    ("update_rate", "50"),
    ("left_wheel_names", "a"),
    ("left_wheel_names", "b"),
    ("linear.x.max_velocity", "1.0"),
    ("linear.x.min_velocity", "-0.5"),
}


@pytest.mark.parametrize("text", [PLAIN, NESTED, SLASHES, OWN_TYPE, INSIDE_MANAGER])
def test_controllers_of_ros_2_are_found_in_every_form(text: str) -> None:
    (found,) = read_controllers([text])

    assert (found.name, found.type) == ("base", DIFF)
    assert set(found.texts) == FOUND


def test_controllers_of_ros_1_are_found_below_namespaces() -> None:
    text = f"""
    robot:
      state: {{type: joint_state_controller/JointStateController, publish_rate: 20}}
      base:
        type: "{DIFF}"
        linear/x: {{max_velocity: 0.4}}
    """

    states, base = read_controllers([text])

    assert states.name == "state"
    assert base == Controller("base", DIFF, [("linear.x.max_velocity", "0.4")])


def test_later_file_overrides_parameters_of_an_earlier_one() -> None:
    (found,) = read_controllers([PLAIN, "base:\n  ros__parameters:\n    left_wheel_names: [c]\n"])

    assert [text for name, text in found.texts if name == "left_wheel_names"] == ["c"]
    assert ("linear.x.max_velocity", "1.0") in found.texts


def test_parameters_of_all_nodes_are_those_of_each_controller() -> None:
    (found,) = read_controllers([PLAIN, "/**:\n  ros__parameters:\n    publish_rate: 30\n"])

    assert ("publish_rate", "30") in found.texts


@pytest.mark.parametrize("text", ["", "[]", "word", "1", "a: b", "# note", "base:\n"])
def test_other_yaml_has_no_controllers(text: str) -> None:
    assert read_controllers([text]) == []


@pytest.mark.parametrize(
    "text", ["a: [", "\t: x", "a: b: c", "&a [*b]", "a: \x00", "{{: }", "a\n---\nb\n---\nc"]
)
def test_text_that_is_not_one_yaml_document_is_refused(text: str) -> None:
    with pytest.raises(ModelError) as refused:
        read_controllers([text])

    assert refused.value.slug == "controllers.syntax"


def nest(depth: int) -> str:
    return "{a: " * depth + "1" + "}" * depth


BOMB = "a: &a [x, x]\n" + "".join(
    f"{chr(98 + n)}: &{chr(98 + n)} {{p: *{chr(97 + n)}, q: *{chr(97 + n)}}}\n" for n in range(20)
)


@pytest.mark.parametrize(
    "texts",
    [
        pytest.param([nest(MAX_YAML_DEPTH + 2)], id="deep"),
        pytest.param(["[" * 100_000], id="very deep"),
        pytest.param(["x" * (MAX_YAML_BYTES + 1)], id="long"),
        pytest.param(["a: 1"] * 17, id="many files"),
        pytest.param(["".join(f"a{n}: 1\n" for n in range(MAX_YAML_NODES + 1))], id="many values"),
        pytest.param([BOMB], id="aliases of aliases"),
        pytest.param(["&a {b: *a}"], id="alias of itself"),
    ],
)
def test_files_beyond_the_limits_are_refused(texts: list[str]) -> None:
    with pytest.raises(ModelError) as refused:
        read_controllers(texts)

    assert refused.value.slug == "controllers.size"


def test_tags_make_no_objects() -> None:
    (found,) = read_controllers(
        [f"base:\n  type: !!python/object/apply:os.system [{DIFF}]\n  x: 1\n", PLAIN]
    )

    assert found.type == DIFF
