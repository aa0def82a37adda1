"""Switches, scans and pictures of sensors on the page of one client."""

from contextlib import nullcontext
from functools import partial

import numpy as np

from zensim.proto.messages.model_messages import Origin
from zensim.spawner.page.robot_colours import find_robot_colour
from zensim.spawner.page.sensor_display import SensorDisplay
from zensim.spawner.page.sensor_views import SensedFrame, SensorChoice, SensorView

SCAN, REAR = SensorChoice("r1", "scan"), SensorChoice("r1", "rear")
CLOUD = SensorChoice("r1", "points")
HEIGHTS = np.array([(1.0, 0.0, 0.0), (1.0, 0.0, 1.0), (1.0, 0.0, 2.0)])
PICTURE = SensorChoice("r1", "image_raw")
VIEWS = {
    SCAN: SensorView("laser", "scan", "scan", 0, Origin()),
    REAR: SensorView("laser2", "rear", "scan", 0, Origin()),
    CLOUD: SensorView("depth", "points", "depth_points", 0, Origin()),
    PICTURE: SensorView("camera", "image_raw", "image_raw", 0, Origin()),
}
FRAME = SensedFrame(
    {SCAN: np.zeros((2, 3)), REAR: np.ones((3, 3))}, {PICTURE: np.zeros((2, 2, 3), np.uint8)}
)


class FakeElement:
    """A node of the scene or element of the panel."""

    def __init__(self, parent: dict[str, "FakeElement"], name: str, **properties: object) -> None:
        self._parent, self._name = parent, name
        self.__dict__.update(properties)
        parent[name] = self

    def on_update(self, report: object) -> None:
        self.report = report

    def remove(self) -> None:
        del self._parent[self._name]


class Setup:
    """A display on a fake client."""

    def __init__(self) -> None:
        self.nodes: dict[str, FakeElement] = {}
        self.elements: dict[str, FakeElement] = {}
        self.switched: list[tuple[SensorChoice, bool]] = []
        self.display = SensorDisplay(self, self)  # type: ignore[arg-type]
        self.open_panel()

    def open_panel(self) -> None:
        self.display.open_panel(
            nullcontext(),  # type: ignore[arg-type]
            VIEWS,
            lambda *event: self.switched.append(event),
        )

    def switch(self, *choices: SensorChoice, is_on: bool = True) -> None:
        for choice in choices:
            self.display.switch(choice, is_on=is_on)

    def add_point_cloud(
        self, path: str, points: np.ndarray, colors: np.ndarray, **_: object
    ) -> FakeElement:
        return FakeElement(self.nodes, path, points=points, colors=colors)

    def add_image(self, image: np.ndarray, *, label: str, **_: object) -> FakeElement:
        return FakeElement(self.elements, f"picture {label}", image=image)

    def add_checkbox(self, label: str, *, initial_value: bool, hint: str) -> FakeElement:
        del hint
        return FakeElement(self.elements, label, value=initial_value)


def test_panel_has_a_switch_for_each_sensor() -> None:
    setup = Setup()

    assert [*setup.elements] == [
        *("Show scan scan", "Show scan rear", "Show scan points", "Show picture image_raw")
    ]
    assert not any(vars(box)["value"] for box in setup.elements.values())


def test_nothing_is_shown_until_switched_on() -> None:
    setup = Setup()

    setup.display.show(FRAME)

    assert setup.nodes == {}
    assert setup.display.chosen == frozenset()


def test_robot_has_one_cloud_of_all_its_scans() -> None:
    setup = Setup()
    setup.switch(SCAN, REAR)

    setup.display.show(FRAME)
    setup.display.show(SensedFrame({SCAN: np.zeros((4, 3))}))

    assert [*setup.nodes] == ["/scans/r1"]
    assert vars(setup.nodes["/scans/r1"])["points"].shape == (7, 3)


def test_cloud_is_a_node_of_its_own_in_the_colours_of_heights() -> None:
    setup = Setup()
    setup.switch(SCAN, CLOUD)

    setup.display.show(SensedFrame({SCAN: np.zeros((2, 3)), CLOUD: HEIGHTS}))

    colours = vars(setup.nodes["/clouds/r1"])["colors"]
    assert colours.shape == (3, 3)
    assert len({*map(tuple, colours.tolist())}) == 3
    assert tuple(vars(setup.nodes["/scans/r1"])["colors"]) == find_robot_colour("r1")
    setup.switch(CLOUD, is_on=False)
    assert [*setup.nodes] == ["/scans/r1"]


def test_switched_off_sensors_are_removed() -> None:
    setup = Setup()
    setup.switch(*VIEWS)
    setup.display.show(FRAME)

    setup.switch(REAR, PICTURE, is_on=False)

    assert vars(setup.nodes["/scans/r1"])["points"].shape == (2, 3)
    assert "picture image_raw" not in setup.elements
    setup.switch(SCAN, is_on=False)
    assert setup.nodes == {}


def test_sensors_of_deleted_robots_are_removed() -> None:
    setup = Setup()
    setup.switch(*VIEWS)
    setup.display.show(FRAME)

    setup.display.keep(())

    assert setup.display.chosen == frozenset()
    assert setup.nodes == {}
    assert "picture image_raw" not in setup.elements


def test_scans_stay_when_the_panel_is_closed() -> None:
    setup = Setup()
    setup.switch(*VIEWS)
    setup.display.show(FRAME)

    setup.display.close_panel()
    setup.elements.clear()
    setup.open_panel()

    assert setup.display.chosen == {SCAN, REAR, CLOUD}
    assert [vars(box)["value"] for box in setup.elements.values()] == [True, True, True, False]


def test_picture_is_updated_in_place() -> None:
    setup = Setup()
    setup.switch(PICTURE)
    setup.display.show(FRAME)
    shown = setup.elements["picture image_raw"]

    setup.display.show(SensedFrame({}, {PICTURE: np.ones((2, 2, 3), np.uint8)}))

    assert setup.elements["picture image_raw"] is shown
    assert vars(shown)["image"].all()


def test_switch_reports_its_sensor() -> None:
    setup = Setup()
    box = setup.elements["Show scan rear"]

    event = partial(vars(box)["report"])
    vars(box)["value"] = True
    event(type("Event", (), {"target": box}))

    assert setup.switched == [(REAR, True)]
