"""Categories, status and encoding of the list of entities."""

import msgspec
import numpy as np
import pytest

from tests.spawner.page.builders import make_models_by_name, make_robot, make_snapshot, make_wall
from zensim.proto.messages.agent_messages import STATE_COLUMNS
from zensim.proto.messages.model_messages import JointController
from zensim.proto.messages.telemetry_messages import GetModelsResponse
from zensim.spawner.page.entity_list import (
    CATEGORIES,
    encode_statuses,
    find_category,
    find_statuses,
    is_blocked,
    list_entities,
)
from zensim.spawner.page.render_state import (
    LastCommand,
    RenderedFleet,
    RenderedFrame,
    make_fleet,
    make_frame,
)

VX, WZ = 7, 12


def a_fleet() -> RenderedFleet:
    box = msgspec.structs.replace(make_wall("box"), is_static=False)
    kinds = {"r1": make_robot(), "r2": make_robot(), "box": box, "wall": make_wall()}
    made = make_models_by_name(kinds)
    entities = [
        msgspec.structs.replace(
            one, agent="a" if one.entity == "r1" else "", belongs_to_world=one.entity == "wall"
        )
        for one in made.entities
    ]
    models = GetModelsResponse(entities=tuple(entities), models=made.models)
    return make_fleet(tuple(kinds), models)


def a_frame(fleet: RenderedFleet, *, vx: float = 0.0, entity: str = "r1") -> RenderedFrame:
    frame = make_frame(fleet, make_snapshot(*fleet.names, joints=fleet.joints))
    base = frame.base.copy()
    base[fleet.rows[entity], VX] = vx
    return RenderedFrame(base, frame.links)


def test_each_entity_has_a_category() -> None:
    fleet = a_fleet()

    found = [find_category(fleet, name) for name in fleet.names]

    assert found == ["Robots", "Robots", "Objects", "World"]


def test_an_arm_is_a_robot_without_the_colour_of_one_that_drives() -> None:
    arm = msgspec.structs.replace(
        make_robot(), drive=None, joint_controllers=(JointController("arm", ("bot_axle",)),)
    )

    fleet = make_fleet(("arm",), make_models_by_name({"arm": arm}))

    assert find_category(fleet, "arm") == "Robots"
    assert fleet.robots == ("arm",)
    assert [one.colour for one in list_entities(fleet)] == [""]


@pytest.mark.parametrize(
    ("entity", "speed", "status"),
    [
        ("r1", 0.0, "standing"),
        ("r1", 0.3, "moving"),
        ("r2", 0.0, "no agent"),
        ("r2", 0.3, "moving"),
        ("box", 0.0, "asleep"),
        ("box", 1e-4, "standing"),
        ("box", -0.3, "moving"),
        ("wall", 0.0, "static"),
    ],
)
def test_status_follows_from_speed_and_agent(entity: str, speed: float, status: str) -> None:
    fleet = a_fleet()

    statuses = find_statuses(fleet, a_frame(fleet, vx=speed, entity=entity), {})

    assert statuses[fleet.rows[entity]] == status


def test_robot_that_stands_despite_its_command_is_blocked() -> None:
    fleet = a_fleet()
    command = {"r1": LastCommand(0.2, 0.0, age_s=0.1), "gone": LastCommand(1.0, 0.0, age_s=0.1)}

    assert find_statuses(fleet, a_frame(fleet), command)[0] == "blocked"
    assert find_statuses(fleet, a_frame(fleet, vx=0.19), command)[0] == "moving"


@pytest.mark.parametrize(
    ("forward", "turn", "age_s", "vx", "wz", "is_so"),
    [
        (0.2, 0.0, 0.1, 0.0, 0.0, True),
        (-0.2, 0.0, 0.1, 0.001, 0.0, True),
        (0.2, 0.0, 0.1, 0.1, 0.0, False),
        (0.2, 0.0, 2.0, 0.0, 0.0, False),
        (0.0, 0.0, 0.1, 0.0, 0.0, False),
        (0.0, 0.5, 0.1, 0.0, 0.0, True),
        (0.0, 0.5, 0.1, 0.0, 0.4, False),
        (0.0, -0.5, 0.1, 0.0, -0.4, False),
    ],
)
def test_blocked_robot_does_not_move_as_commanded(
    forward: float, turn: float, age_s: float, vx: float, wz: float, *, is_so: bool
) -> None:
    state = np.zeros(STATE_COLUMNS)
    state[VX], state[WZ] = vx, wz

    assert is_blocked(state, LastCommand(forward, turn, age_s)) is is_so


def test_list_has_category_words_and_colour_of_each_entity() -> None:
    listed = list_entities(a_fleet())

    assert [one.name for one in listed] == ["r1", "r2", "box", "wall"]
    assert [CATEGORIES[one.category] for one in listed] == ["Robots", "Robots", "Objects", "World"]
    assert listed[1].words == "r2 bot"
    assert [bool(one.colour) for one in listed] == [True, True, False, False]


def test_statuses_are_letters_and_centimetres_a_second() -> None:
    fleet = a_fleet()
    frame = a_frame(fleet, vx=0.304)

    letters, speeds = encode_statuses(find_statuses(fleet, frame, {}), frame)

    assert letters == '"mnzt"'
    assert speeds == "[30,0,0,0]"
