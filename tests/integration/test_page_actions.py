"""What visitors do with the page, observed on the bus of a real server."""

import signal
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager

import pytest

from tests.integration.page_user import PageUser
from tests.integration.processes import END_S, Server, eventually, free_endpoint, running, serving
from zensim.proto.cmd_vel_decoding import decode_twist
from zensim.proto.messages.entity_messages import EntityState
from zensim.proto.messages.simulation_messages import State
from zensim.proto.messages.standard_messages import Twist
from zensim.proto.network_protocols import Subscription
from zensim.proto.topic_catalog import CMD_VEL

NAMES = ("r1", "r2", "r3")
DRIVE = {"forward": 1.0, "left": 0.0, "turn": 0.0}
UNDRIVEN = "r2"
"""No test drives it, so that no command of another test is on its topic."""


@contextmanager
def viewing(endpoint: str, *options: str) -> Iterator[str]:
    with running("view", "--connect", endpoint, "--port", "0", *options) as process:
        assert process.stdout is not None
        yield process.stdout.readline().split()[-1]


@pytest.fixture(scope="module")
def server() -> Iterator[Server]:
    with serving() as found:
        for number, name in enumerate(NAMES):
            done = found.zensim("spawn", "box_bot", "--name", name, "-x", str(number), "-y", "0")
            assert done.returncode == 0, done.stderr
        yield found


@pytest.fixture(scope="module")
def url(server: Server) -> Iterator[str]:
    with viewing(server.endpoint) as found:
        yield found


@pytest.fixture
def visitor(url: str) -> Iterator[PageUser]:
    with PageUser(url) as found:
        yield found


@pytest.fixture
def commands(server: Server) -> Iterator[Subscription]:
    found = server.bus.subscribe(CMD_VEL.key("r1"), depth=1000)
    yield found
    found.close()


def select(visitor: PageUser, name: str) -> None:
    """Select an entity, once the page has it: what is not there yet is not selected."""
    visitor.wait_for_row(name)
    visitor.send("ZensimSelect", entity=name)
    eventually(lambda: f"{name}: driven by" in visitor.texts(), 10.0, f"selecting {name}")


def wait_for_models(visitor: PageUser) -> None:
    eventually(lambda: "box_bot" in visitor.options_of("Model"), 10.0, "models")


def wait_for_notification(visitor: PageUser, text: str) -> None:
    eventually(lambda: text in str(visitor.notifications), 10.0, f"notification {text!r}")


def click_floor(visitor: PageUser, x: float, y: float, height_m: float = 3.0) -> None:
    """Click a point of the floor, seen from straight above it."""
    eventually(lambda: visitor.waits_for_click, 5.0, "waiting for a click")
    visitor.send(
        "ScenePointerMessage",
        event_type="click",
        ray_origin=(x, y, height_m),
        ray_direction=(0.0, 0.0, -1.0),
        screen_pos=((0.5, 0.5),),
        modifier=None,
    )


def read(commands: Subscription) -> list[Twist]:
    return [decode_twist(one.payload, one.encoding) for one in commands.take()]


def state_of(server: Server, name: str) -> EntityState:
    return server.client.entity_state(name)


def test_a_held_key_drives_the_selected_robot(visitor: PageUser, commands: Subscription) -> None:
    select(visitor, "r1")

    visitor.send("ZensimDrive", **DRIVE)

    eventually(lambda: any(one.linear.x > 0.0 for one in read(commands)), 5.0, "driving")


def test_a_held_key_turns_the_selected_robot(visitor: PageUser, commands: Subscription) -> None:
    select(visitor, "r1")

    visitor.send("ZensimDrive", **(DRIVE | {"forward": 0.0, "turn": -1.0}))

    eventually(lambda: any(one.angular.z < 0.0 for one in read(commands)), 5.0, "turning")


def test_stop_all_stops_robots_that_another_program_drives(
    server: Server, visitor: PageUser
) -> None:
    visitor.wait_for_row(UNDRIVEN)
    with closing(server.bus.subscribe(CMD_VEL.key(UNDRIVEN), depth=1000)) as commands:
        visitor.press("Stop all")

        eventually(lambda: Twist() in read(commands), 5.0, f"a stop of {UNDRIVEN}")


def test_a_robot_drives_towards_the_clicked_point_of_the_floor(
    visitor: PageUser, commands: Subscription
) -> None:
    select(visitor, "r1")
    read(commands)

    visitor.press("Drive to")
    click_floor(visitor, 0.0, 5.0)

    eventually(lambda: any(one.angular.z > 0.0 for one in read(commands)), 5.0, "turning left")
    visitor.send("ZensimDrive", **dict.fromkeys(DRIVE, 0.0))
    eventually(lambda: Twist() in read(commands), 5.0, "stopping")


def test_a_click_on_the_sky_is_refused(visitor: PageUser) -> None:
    select(visitor, "r1")

    visitor.press("Drive to")
    click_floor(visitor, 0.0, 5.0, height_m=-1.0)

    wait_for_notification(visitor, "not on the floor")


@pytest.mark.parametrize("label", ["Drive to", "Move", "Delete"])
def test_controls_of_the_selected_entity_say_that_there_is_none(url: str, label: str) -> None:
    with PageUser(url) as visitor:
        visitor.press(label)

        wait_for_notification(visitor, "selected")


def test_only_a_selected_robot_can_be_taken_over(visitor: PageUser) -> None:
    def is_off() -> bool:
        return bool(visitor.control("Take over")["props"]["disabled"])

    assert is_off()

    select(visitor, "r1")

    eventually(lambda: not is_off(), 10.0, "the button")


def test_a_spawned_robot_stands_where_the_floor_was_clicked(
    server: Server, visitor: PageUser
) -> None:
    wait_for_models(visitor)
    visitor.give("Model", "box_bot")
    visitor.give("Name", "placed")
    visitor.press("Place by click")
    click_floor(visitor, 2.0, -3.0)
    eventually(lambda: visitor.value_of("Place x, y [m]") == [2.0, -3.0], 5.0, "the place")

    visitor.press("Spawn")

    eventually(lambda: "placed" in server.client.entities(), 10.0, "spawning")
    wait_for_notification(visitor, "spawned placed")
    assert state_of(server, "placed").pose.position.x == pytest.approx(2.0, abs=0.05)
    assert state_of(server, "placed").pose.position.y == pytest.approx(-3.0, abs=0.05)


def test_a_refused_spawn_shows_the_reason_of_the_server(visitor: PageUser) -> None:
    wait_for_models(visitor)
    visitor.give("Name", "r1")

    visitor.press("Spawn")

    wait_for_notification(visitor, "'r1' already exists")


def test_a_spawn_inside_another_robot_is_told(server: Server, visitor: PageUser) -> None:
    wait_for_models(visitor)
    place = state_of(server, "r1").pose.position
    visitor.give("Model", "box_bot")
    visitor.give("Name", "inside")
    visitor.give("Place x, y [m]", (place.x, place.y))

    visitor.press("Spawn")

    wait_for_notification(visitor, "overlaps entity 'r1'")
    server.client.delete("inside")


def test_several_robots_are_spawned_in_a_layout(server: Server, visitor: PageUser) -> None:
    wait_for_models(visitor)
    visitor.give("Name", "line")
    visitor.give("Count", 3)
    visitor.give("Layout", "row")
    visitor.give("Spacing [m]", 2.0)
    visitor.give("Place x, y [m]", (0.0, 6.0))
    visitor.give("Heading [deg]", 90.0)

    visitor.press("Spawn")

    eventually(lambda: "line2" in server.client.entities(), 10.0, "spawning")
    last = state_of(server, "line2").pose.position
    assert (last.x, last.y) == pytest.approx((0.0, 10.0), abs=0.05)


def test_spawns_of_five_visitors_are_neither_lost_nor_doubled(server: Server, url: str) -> None:
    before = set(server.client.entities())
    with ExitStack() as stack:
        visitors = [stack.enter_context(PageUser(url)) for _ in range(5)]
        for number, one in enumerate(visitors):
            wait_for_models(one)
            one.give("Model", "box_bot")
            one.give("Place x, y [m]", (20.0 + 2.0 * number, 20.0))
        for _ in range(10):
            for one in visitors:
                one.press("Spawn")

        def count() -> int:
            return len(set(server.client.entities()) - before)

        eventually(lambda: count() >= 50, 30.0, "50 spawns")
        eventually(
            lambda: sum(str(o.notifications).count("spawned") for o in visitors) == 50, 10.0, "told"
        )
        assert count() == 50
    for name in set(server.client.entities()) - before:
        server.client.delete(name)


def test_an_entity_is_deleted_after_a_while_and_kept_by_undo(
    server: Server, visitor: PageUser
) -> None:
    for name in ("kept", "gone"):
        assert server.zensim("spawn", "box_bot", "--name", name, "-x", "-5").returncode == 0
        select(visitor, name)
        visitor.press("Delete")
        wait_for_notification(visitor, f"{name}: deleted in")
        if name == "kept":
            visitor.press("Undo")
            wait_for_notification(visitor, "kept: kept")

    # It was deleted later, so the other one would be deleted by now.
    eventually(lambda: "gone" not in server.client.entities(), 20.0, "deletion")
    assert "kept" in server.client.entities()


def test_a_page_that_is_closed_deletes_what_its_visitor_deleted(server: Server, url: str) -> None:
    assert server.zensim("spawn", "box_bot", "--name", "left", "-x", "-8").returncode == 0
    with PageUser(url) as visitor:
        select(visitor, "left")
        visitor.press("Delete")
        wait_for_notification(visitor, "left: deleted in")

    eventually(lambda: "left" not in server.client.entities(), 20.0, "deletion")


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_page_that_is_ended_deletes_what_its_visitors_deleted(
    server: Server, number: signal.Signals
) -> None:
    name = f"left_{number.name}"
    assert server.zensim("spawn", "box_bot", "--name", name, "-x", "-9").returncode == 0
    with running("view", "--connect", server.endpoint, "--port", "0") as process:
        assert process.stdout is not None
        with PageUser(process.stdout.readline().split()[-1]) as visitor:
            select(visitor, name)
            visitor.press("Delete")
            wait_for_notification(visitor, f"{name}: deleted in")

            process.send_signal(number)
            assert process.wait(END_S) == 0

    assert name not in server.client.entities()


def test_an_entity_is_moved_by_numbers_and_by_handles(server: Server, visitor: PageUser) -> None:
    select(visitor, "r3")
    visitor.give("Move to x, y [m], heading [deg]", (4.0, -4.0, 90.0))
    visitor.press("Move")
    eventually(lambda: abs(state_of(server, "r3").pose.position.y + 4.0) < 0.1, 5.0, "moving")
    assert state_of(server, "r3").pose.orientation.z == pytest.approx(0.707, abs=0.05)

    visitor.press("Handles")
    eventually(lambda: "/handles" in visitor.nodes, 5.0, "handles")
    moved = {"wxyz": (1.0, 0.0, 0.0, 0.0), "position": (-4.0, -6.0, 0.1)}

    def drags() -> bool:
        """Drag; the page may not listen yet, which the first visitor of a busy host notices."""
        visitor.send("TransformControlsDragStartMessage", name="/handles", owner=visitor.owner)
        visitor.send(
            "TransformControlsUpdateMessage", name="/handles", owner=visitor.owner, **moved
        )
        visitor.send("TransformControlsDragEndMessage", name="/handles", owner=visitor.owner)
        return abs(state_of(server, "r3").pose.position.x + 4.0) < 0.1

    eventually(drags, 5.0, "dragging")


def test_time_of_the_page_is_that_of_the_bus(server: Server, visitor: PageUser) -> None:
    client = server.client
    visitor.act("Pause")
    eventually(lambda: client.simulation_state() == State.PAUSED, 5.0, "a pause")
    eventually(lambda: "paused" in visitor.texts(), 5.0, "the page's state")
    before = client.info()

    visitor.press("Step", "10 steps")
    eventually(lambda: client.info().steps == before.steps + 10, 5.0, "ten steps")
    visitor.press("Step", "1 step")
    eventually(lambda: client.info().steps == before.steps + 11, 5.0, "one step")
    visitor.press("Step", "1 s")
    eventually(lambda: client.info().sim_time_s > before.sim_time_s + 0.99, 10.0, "a second")

    goal = round(client.info().sim_time_s + 2.0, 1)
    visitor.give("Time [s]", goal)
    visitor.press("Run to this time")

    def is_there() -> bool:
        if "runs the world" in str(visitor.notifications):  # for the second, still
            visitor.notifications.clear()
            visitor.press("Run to this time")
        return abs(client.info().sim_time_s - goal) < 0.01

    eventually(is_there, 20.0, "run-to")
    assert client.simulation_state() == State.PAUSED

    visitor.act("Play")
    eventually(lambda: client.simulation_state() == State.PLAYING, 5.0, "playing")


def test_a_run_to_the_past_is_refused_with_the_reason(server: Server, visitor: PageUser) -> None:
    visitor.give("Time [s]", 0.0)
    visitor.press("Run to this time")

    wait_for_notification(visitor, "before the current time")
    assert server.client.simulation_state() == State.PLAYING


def test_the_slider_sets_the_wanted_factor_and_shows_that_of_others(
    server: Server, visitor: PageUser
) -> None:
    visitor.give("Speed", 0.5)
    eventually(lambda: server.client.info().target_real_time_factor == 0.5, 5.0, "0.5")
    eventually(lambda: "of 0.50 wanted" in visitor.texts(), 5.0, "the text")

    server.client.set_speed(2.0)
    eventually(lambda: visitor.value_of("Speed") == 2.0, 5.0, "the slider")

    visitor.give("Speed", 1.0)
    eventually(lambda: server.client.info().target_real_time_factor == 1.0, 5.0, "1.0")


def test_a_reset_sets_the_time_back(server: Server, visitor: PageUser) -> None:
    before = server.client.info().epoch

    visitor.act("Reset time and poses")

    eventually(lambda: server.client.info().epoch == before + 1, 5.0, "a reset")


@pytest.mark.parametrize("command", ["Play or pause", "Step once", "Reset time and poses"])
def test_commands_of_the_palette_control_the_time(
    server: Server, visitor: PageUser, command: str
) -> None:
    # The page acts on the state that it has seen.
    eventually(lambda: "playing" in visitor.texts(), 10.0, "a page that plays")
    before = server.client.info()
    visitor.run(command)

    def is_done() -> bool:
        now = server.client.info()
        return now.state != before.state or now.epoch != before.epoch

    eventually(is_done, 5.0, command)
    if server.client.simulation_state() != State.PLAYING:
        server.client.set_simulation_state(State.PLAYING)


def test_a_read_only_page_has_no_control_that_changes_the_world(server: Server) -> None:
    with viewing(server.endpoint, "--read-only") as url, PageUser(url) as visitor:
        visitor.control("Names")
        forbidden = {"Spawn", "Delete", "Stop all", "Step", "Run to this time"}

        assert not visitor.list_labels() & forbidden
        assert 'data-zensim-part="head"' not in visitor.texts()
        visitor.act("Pause")
        visitor.act("Show all")
        visitor.give("Names", value=True)  # what was sent before has been read
        eventually(lambda: "/names/r1" in visitor.nodes, 20.0, "names")
        assert server.client.simulation_state() == State.PLAYING


def test_a_lost_server_greys_the_page_until_it_is_back() -> None:
    endpoint = free_endpoint()
    with serving(endpoint=endpoint) as first, viewing(endpoint) as url, PageUser(url) as user:
        eventually(lambda: "playing" in user.texts(), 10.0, "a live page")

        first.process.kill()

        eventually(lambda: "zensimGreys(true)" in user.scripts, 10.0, "a grey scene")
        eventually(lambda: "no server" in user.texts(), 10.0, "the state")
        with serving(endpoint=endpoint):
            eventually(lambda: user.scripts[-1] == "zensimGreys(false)", 10.0, "colours")
            eventually(lambda: "playing" in user.texts(), 10.0, "a live page")
