"""The layout names panels and topics that exist."""

import json

from zensim.foxglove.panel_layout import write_layout


def list_panels(tree: object) -> set[str]:
    if isinstance(tree, str):
        return {tree}
    assert isinstance(tree, dict)
    return list_panels(tree["first"]) | list_panels(tree["second"])


def test_layout_places_each_configured_panel_once() -> None:
    layout = json.loads(write_layout("w", "lab/r7"))

    assert list_panels(layout["layout"]) == set(layout["configById"])


def test_layout_names_the_robot_and_the_world() -> None:
    configured = json.loads(write_layout("w", "lab/r7"))["configById"]

    assert configured["Teleop!zensim"]["topic"] == "/lab/r7/cmd_vel"
    assert configured["Plot!pace"]["paths"][0]["value"] == "/sim/w/stats.real_time_factor"
    assert configured["3D!zensim"]["topics"]["/zensim/scene"] == {"visible": True}
