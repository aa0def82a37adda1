"""A model as JSON and as a tree."""

import json

from tests.sim_server.description.robots import a_link, a_robot, an_inertial
from zensim.sim_server.description.builtin_models import read_builtin_model
from zensim.sim_server.description.model_printer import format_model_tree, model_to_json
from zensim.sim_server.description.plugins.sensor_reader import complete_sensors
from zensim.sim_server.description.urdf.urdf_parser import read_urdf

BOX_BOT = read_urdf(read_builtin_model("box_bot"))


def test_json_lists_what_the_model_holds() -> None:
    shown = json.loads(json.dumps(model_to_json(BOX_BOT)))

    assert [link["name"] for link in shown["links"]] == ["base_link", "left_wheel", "right_wheel"]
    assert shown["joints"][0] == {
        "name": "left_wheel_joint",
        "kind": "continuous",
        "parent": "base_link",
        "child": "left_wheel",
    }
    assert shown["mass_kg"] == 1.4
    assert shown["drive"]["pairs"][0]["separation_m"] == 0.11
    assert shown["joint_state"]["update_rate_hz"] == 30.0
    assert {frame["name"] for frame in shown["frames"]} >= {"chassis", "rgb_cam_frame"}
    assert {entry["status"] for entry in shown["report"]} == {"applied"}


def test_json_lists_the_sensors() -> None:
    model = complete_sensors(read_urdf(read_builtin_model("box_bot_lidar")), "fixed")

    lidar, imu, bumper = json.loads(json.dumps(model_to_json(model)))["sensors"]

    assert lidar["topics"] == [{"name": "scan", "message": "LaserScan"}]
    assert (lidar["frame_id"], lidar["update_rate_hz"]) == ("lidar_link", 10.0)
    assert lidar["cpu_s_per_message"] > imu["cpu_s_per_message"] > 0.0
    assert (bumper["kind"], bumper["is_simulated"]) == ("contact", True)


def test_json_has_no_drive_when_the_model_has_none() -> None:
    assert model_to_json(read_urdf(a_robot(a_link("a", an_inertial()))))["drive"] is None


def test_tree_text_has_links_below_their_parents() -> None:
    lines = format_model_tree(BOX_BOT).splitlines()

    assert lines[:3] == ["box_bot: 1.400 kg", "base_link 1.000 kg", "  (base_footprint, merged)"]
    assert "  left_wheel 0.200 kg by continuous left_wheel_joint" in lines
    assert (
        "drive: left_wheel_joint and right_wheel_joint, separation 0.11 m, diameter 0.07 m" in lines
    )
    assert (
        "applied    gazebo 'left_wheel', 'right_wheel', 'front_caster' and 1 more: <mu1>: (4 times)"
        in lines
    )


def test_tree_text_has_no_drive() -> None:
    assert format_model_tree(read_urdf(a_robot(a_link("a", an_inertial())))).splitlines() == [
        "r: 1.000 kg",
        "a 1.000 kg",
        "no drive",
    ]
