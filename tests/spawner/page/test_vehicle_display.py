"""Routes of selected vehicles, and what their orders are."""

import numpy as np
import pytest

from tests.spawner.page.test_motion_overlays import FakeScene, a_fleet, a_state
from zensim.proto.messages.result_messages import Result
from zensim.proto.messages.vehicle_messages import FleetStatus, VehicleStatus
from zensim.spawner.page.vehicle_display import VehicleDisplay

WAY = np.array([(0.0, 0.0), (1.0, 0.0), (1.0, 2.0)], "<f4").tobytes()


def make(scene: FakeScene, *vehicles: VehicleStatus) -> VehicleDisplay:
    display = VehicleDisplay(scene)  # type: ignore[arg-type]
    display.receive(FleetStatus(vehicles))
    return display


def test_route_of_a_selected_vehicle_begins_where_it_is() -> None:
    scene = FakeScene()
    display = make(scene, VehicleStatus("r1", route=WAY), VehicleStatus("r2", route=WAY))

    display.draw(("r1",), a_state(a_fleet("r1", "r2"), at_x=0.25))

    points = scene.nodes["/routes"].points
    assert points.shape == (2, 2, 3)
    assert points[:, :, :2].tolist() == [[[0.25, 0.0], [1.0, 0.0]], [[1.0, 0.0], [1.0, 2.0]]]


def test_route_is_removed_with_the_selection_and_with_the_order() -> None:
    scene = FakeScene()
    display = make(scene, VehicleStatus("r1", route=WAY))
    state = a_state(a_fleet("r1"))
    display.draw(("r1",), state)
    display.draw((), state)
    assert not scene.nodes

    display.draw(("r1",), state)
    display.receive(FleetStatus((VehicleStatus("r1", "o1"),)))
    display.draw(("r1",), state)

    assert not scene.nodes


def test_route_that_stays_is_not_sent_again() -> None:
    scene = FakeScene()
    display = make(scene, VehicleStatus("r1", route=WAY))

    for _ in range(3):
        display.draw(("r1",), a_state(a_fleet("r1")))

    assert scene.nodes["/routes"].sets == 0


@pytest.mark.parametrize("route", [WAY[:-1], np.array([(0.0, np.nan)] * 3, "<f4").tobytes()])
def test_route_that_is_no_list_of_points_is_not_drawn(route: bytes) -> None:
    scene = FakeScene()

    make(scene, VehicleStatus("r1", route=route)).draw(("r1",), a_state(a_fleet("r1")))

    assert not scene.nodes


def test_messages_of_other_topics_change_nothing() -> None:
    display = make(FakeScene(), VehicleStatus("r1", "o1"))

    display.receive(Result())

    assert display.find("r1") == VehicleStatus("r1", "o1")
