"""Every public method refuses arguments of a wrong type or range by the documented errors."""

import inspect
import math
import os
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from types import FunctionType

import pytest

import zensim
from zensim.spawner.spawn.description_xml import MAX_TEXT_BYTES

WRONG: tuple[object, ...] = (
    None,
    object(),
    "no such thing",
    b"x",
    math.nan,
    math.inf,
    -1.5,
    [],
    [1, 2, 3, 4, 5],
    1e30,
)
"""Some are right for some parameters, which is no failure."""
KINDS = {"sim": zensim.World, "robot": zensim.Robot, "fleet": zensim.Fleet, "topic": zensim.Topic}
LEFT_OUT = frozenset({"attach", "call", "close", "collect", "load", "pause", "play", "reset"})
"""Without arguments; or they take what the caller's own code is called with later."""
PATIENT = frozenset({"timeout_s", "within", "progress", "after"})
"""Parameters for which an endless wait is right, or the output."""
VALID = {
    "model": "box_bot",
    "name": "r1",
    "seconds": 0.0,
    "time": 0.0,
    "condition": lambda: True,
    "origins": [[0.0, 0.0, 1.0]],
    "directions": [[1.0, 0.0, 0.0]],
    "key": "r1/odom",
    "names": ["r1"],
    "x": 0.0,
    "y": 0.0,
    "points": [(1.0, 0.0)],
    "topic": "odom",
    "call": lambda _: None,
    "kind": "wheel_slip",
    "part": "left_wheel_joint",
}


@pytest.mark.parametrize("seconds", [-1, "2", math.nan])
def test_robot_stands_when_the_time_of_its_order_is_wrong(seconds: object) -> None:
    with zensim.World() as world:
        robot = world.spawn("box_bot", name="r1")

        with pytest.raises(zensim.Invalid):
            robot.drive(0.5, seconds=seconds)  # type: ignore[arg-type]
        world.run_for(0.5)

        assert abs(robot.twist[0]) < 1e-3


def test_row_beyond_a_fleet_is_named_with_their_count() -> None:
    with zensim.World() as world:
        world.spawn("box_bot", name="r1")

        with pytest.raises(IndexError, match=r"row 5 .* 1 robots"):
            world.fleet(["r1"])[5]


def list_parameters() -> Iterator[tuple[str, str, str]]:
    """List kind, method and parameter of all that can be given."""
    for kind, made in KINDS.items():
        for name, method in inspect.getmembers(made, inspect.isfunction):
            if name[0] != "_" and name not in LEFT_OUT:
                yield from ((kind, name, one) for one in parameters_of(method))


def parameters_of(method: FunctionType) -> list[str]:
    found = list(inspect.signature(method).parameters.values())[1:]
    named = [one for one in found if one.kind not in (one.VAR_KEYWORD, one.VAR_POSITIONAL)]
    return [one.name for one in named if one.name not in PATIENT]


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> Iterator[zensim.World]:
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(tmp_path_factory.mktemp("recordings"))  # a text is a right path of one
        with zensim.World() as made:
            yield made


@pytest.fixture
def handles(world: zensim.World) -> dict[str, object]:
    world.reset()
    robot = world.spawn("box_bot", name="r1")
    fleet = world.spawn_fleet("box_bot", count=2, prefix="f", layout="row", spacing=3.0)
    return {"sim": world, "robot": robot, "fleet": fleet, "topic": robot.topic("odom")}


@pytest.mark.parametrize(("kind", "name", "parameter"), list(list_parameters()))
def test_wrong_argument_is_refused(
    handles: dict[str, object], kind: str, name: str, parameter: str
) -> None:
    signature = inspect.signature(getattr(KINDS[kind], name))
    needed = {
        one.name: VALID.get(one.name)
        for one in list(signature.parameters.values())[1:]
        if one.default is one.empty and one.kind is one.POSITIONAL_OR_KEYWORD
    }
    texts = [
        find_refusal(getattr(handles[kind], name), needed | {parameter: wrong}) for wrong in WRONG
    ]

    assert [text for text in texts if "\n" in text] == []


def find_refusal(method: Callable[..., object], arguments: dict[str, object]) -> str:
    """Call a method; return the text of its error, empty without one."""
    try:
        found = method(**arguments)
        if isinstance(found, Iterator):
            next(found, None)
    except (zensim.Error, TypeError) as error:
        return str(error)
    return ""


def test_files_that_cannot_be_read_are_refused(tmp_path: Path) -> None:
    (tmp_path / "large.urdf").write_bytes(b" " * (MAX_TEXT_BYTES + 1))
    os.mkfifo(tmp_path / "pipe.yaml")

    with zensim.World() as world:
        for model, controllers in (
            (tmp_path, []),
            (tmp_path / "large.urdf", []),
            ("box_bot", [tmp_path / "pipe.yaml"]),
        ):
            with pytest.raises(zensim.Error, match=re.escape(str(tmp_path))):
                world.spawn(model, controllers=controllers)


@pytest.mark.parametrize(
    ("call", "argument"),
    [
        (lambda world: world.step(1.5), "count=1.5"),
        (lambda world: world.step(True), "count=True"),  # noqa: FBT003
        (lambda world: world.spawn_fleet("box_bot", count=2.5), "count=2.5"),
        (lambda world: world.spawn("box_bot", x="a"), "x=a"),
        (lambda world: world.spawn("box_bot", yaw=None), "yaw=None"),
        (lambda world: world.spawn("box_bot", z=float("nan")), "z=nan"),
        (lambda world: world.spawn("box_bot", name=5), "name=5"),
    ],
)
def test_error_names_the_argument(
    world: zensim.World, call: Callable[[zensim.World], object], argument: str
) -> None:
    with pytest.raises(zensim.Invalid, match=re.escape(argument)):
        call(world)


def test_topic_has_no_newest_message_before_the_first(world: zensim.World) -> None:
    topic = world.topic("nobody/odom")

    assert topic.latest is None
    with pytest.raises(zensim.NotFound) as found:
        topic.newest()

    assert found.value.slug == "no_message"


def test_world_says_what_it_is() -> None:
    with zensim.World("walls", engine="mujoco") as world:
        world.step(240)
        text = repr(world)

    assert "mujoco" in text
    assert "1.000 s" in text
    assert repr(world) == "<World, closed>"
