"""Trails and velocity arrows."""

import msgspec
import numpy as np

from tests.fakes import ManualClock
from tests.spawner.page.builders import make_models_by_name, make_robot, make_snapshot, make_wall
from zensim.spawner.page.model_visuals import Array
from zensim.spawner.page.motion_overlays import (
    COMMANDED,
    MAX_TRAILS,
    MEASURED,
    TRAIL_POINTS,
    TrailHistory,
    Trails,
    VelocityArrows,
)
from zensim.spawner.page.render_state import (
    LastCommand,
    RenderedFleet,
    RenderedFrame,
    SimulationStatus,
    make_fleet,
    make_frame,
)
from zensim.spawner.page.robot_colours import to_linear
from zensim.spawner.page.viewer_client import PageState


class FakeNode:
    """A node of the scene; counts how often its points are set."""

    def __init__(self, scene: "FakeScene", path: str, points: Array, colours: object) -> None:
        self._scene, self.path, self.colours = scene, path, colours
        self.sets = 0
        self._points = points
        scene.nodes[path] = self

    @property
    def points(self) -> Array:
        return self._points

    @points.setter
    def points(self, points: Array) -> None:
        self._points, self.sets = points, self.sets + 1

    def remove(self) -> None:
        del self._scene.nodes[self.path]


class FakeScene:
    """Scene nodes by path."""

    def __init__(self) -> None:
        self.nodes: dict[str, FakeNode] = {}

    def add_line_segments(self, path: str, points: Array, colors: object, **_: object) -> FakeNode:
        return FakeNode(self, path, points, colors)

    def add_arrows(self, path: str, points: Array, colors: object, **_: object) -> FakeNode:
        return FakeNode(self, path, points, colors)


def a_fleet(*names: str) -> RenderedFleet:
    kinds = {name: make_wall() if name.startswith("w") else make_robot() for name in names}
    return make_fleet(names, make_models_by_name(kinds))


def a_state(fleet: RenderedFleet, *, at_x: float = 0.0, time_s: float = 1.0) -> PageState:
    frame = make_frame(fleet, make_snapshot(*fleet.names, joints=fleet.joints, at_x=at_x))
    return PageState(fleet, frame, SimulationStatus(sim_time_s=time_s))


def with_speed(state: PageState, name: str, *velocity: float) -> PageState:
    base = state.frame.base.copy()
    base[state.fleet.rows[name], 7:10] = velocity
    return msgspec.structs.replace(state, frame=RenderedFrame(base, state.frame.links))


def at(*points: tuple[float, float]) -> Array:
    return np.array([(x, y, 0.0) for x, y in points])


def test_history_keeps_the_last_positions() -> None:
    history = TrailHistory()

    for step in range(TRAIL_POINTS + 5):
        assert history.add(("r1",), at((0.1 * step, 0.0)), float(step + 1))

    assert history.points[0, -1, 0] == 0.1 * (TRAIL_POINTS + 4)
    assert history.points[0, 0, 0] == 0.1 * 5
    assert history.make_segments().shape == (TRAIL_POINTS - 1, 2, 3)


def test_history_has_no_new_point_while_time_stands() -> None:
    history = TrailHistory()
    history.add(("r1",), at((0.0, 0.0)), 1.0)

    assert not history.add(("r1",), at((0.0, 0.0)), 1.0)


def test_history_of_an_entity_stays_when_others_come_and_go() -> None:
    history = TrailHistory()
    history.add(("r1", "r2"), at((0.0, 0.0), (5.0, 0.0)), 1.0)
    history.add(("r1", "r2"), at((0.0, 0.0), (5.5, 0.0)), 2.0)

    history.add(("r2", "r3"), at((5.5, 0.0), (9.0, 0.0)), 3.0)

    assert history.points[0, -3:, 0].tolist() == [5.0, 5.5, 5.5]
    assert history.points[1, :, 0].tolist() == [9.0] * TRAIL_POINTS


def test_trail_begins_anew_after_a_placement_and_a_reset() -> None:
    history = TrailHistory()
    history.add(("r1",), at((0.0, 0.0)), 1.0)
    history.add(("r1",), at((4.0, 0.0)), 2.0)
    assert history.points[0, :, 0].tolist() == [4.0] * TRAIL_POINTS

    history.add(("r1",), at((4.5, 0.0)), 3.0)
    history.add(("r1",), at((4.4, 0.0)), 0.1)
    assert history.points[0, :, 0].tolist() == [4.4] * TRAIL_POINTS


def test_trails_of_robots_are_sent_in_one_node_in_their_colours() -> None:
    scene, clock = FakeScene(), ManualClock()
    trails = Trails(scene, lambda name: (100 + int(name[1:]), 0, 0), clock)  # type: ignore[arg-type]
    fleet = a_fleet("r7", "w1", "r9")

    for step in range(8):
        clock.sleep(0.3)
        trails.draw(fleet.names, a_state(fleet, at_x=0.1 * step, time_s=step + 1.0))

    node = scene.nodes["/trails"]
    assert node.points.shape == (2 * (TRAIL_POINTS - 1), 2, 3)
    colours = np.asarray(node.colours)
    assert colours[0, 0].tolist() == to_linear([(107, 0, 0)]).tolist()[0]
    assert colours[-1, 1].tolist() == to_linear([(109, 0, 0)]).tolist()[0]
    assert 3 <= node.sets <= 5


def test_trails_send_nothing_while_the_world_stands() -> None:
    scene, clock = FakeScene(), ManualClock()
    trails = Trails(scene, lambda _: (0, 0, 0), clock)  # type: ignore[arg-type]
    fleet = a_fleet("r1")

    for _ in range(20):
        clock.sleep(0.3)
        trails.draw(fleet.names, a_state(fleet))

    assert scene.nodes["/trails"].sets == 0


def test_trails_are_limited_and_removed() -> None:
    scene, clock = FakeScene(), ManualClock(5.0)
    trails = Trails(scene, lambda _: (0, 0, 0), clock)  # type: ignore[arg-type]
    fleet = a_fleet(*(f"r{number}" for number in range(MAX_TRAILS + 20)))

    trails.draw(fleet.names, a_state(fleet))
    assert len(scene.nodes["/trails"].points) == MAX_TRAILS * (TRAIL_POINTS - 1)

    trails.clear()
    assert scene.nodes == {}


def test_arrows_show_measured_and_commanded_velocity() -> None:
    scene, clock = FakeScene(), ManualClock(5.0)
    arrows = VelocityArrows(scene, clock)  # type: ignore[arg-type]
    fleet = a_fleet("r1", "r2")
    state = with_speed(a_state(fleet), "r2", 0.0, 0.5, 0.0)

    arrows.draw(
        fleet.names, msgspec.structs.replace(state, commands={"r1": LastCommand(0.3, 0, 0)})
    )

    measured, commanded = (scene.nodes[f"/velocities/{one}"] for one in ("measured", "commanded"))
    shown = [np.asarray(node.colours).tolist() for node in (measured, commanded)]
    assert shown == to_linear([MEASURED, COMMANDED]).tolist()
    ((start, end),) = measured.points
    assert (end - start).tolist() == [0.0, 0.5, 0.0]
    ((start, end),) = commanded.points
    np.testing.assert_allclose(end - start, (0.3, 0.0, 0.0))


def test_arrow_vanishes_when_its_robot_stands() -> None:
    scene, clock = FakeScene(), ManualClock(5.0)
    arrows = VelocityArrows(scene, clock)  # type: ignore[arg-type]
    fleet = a_fleet("r1")
    arrows.draw(fleet.names, with_speed(a_state(fleet), "r1", 0.5, 0.0, 0.0))
    assert "/velocities/measured" in scene.nodes

    clock.sleep(1.0)
    arrows.draw(fleet.names, a_state(fleet))
    assert scene.nodes == {}
