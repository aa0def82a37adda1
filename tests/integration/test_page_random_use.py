"""Random messages on all controls of the page, with a real server."""

import math
import random
import signal
from collections.abc import Callable
from contextlib import ExitStack, suppress
from typing import Any

from tests.integration.page_user import PageUser
from tests.integration.processes import END_S, Server, eventually, serving
from tests.integration.test_view import viewing
from zensim.proto.messages.result_messages import ServiceError
from zensim.proto.messages.simulation_messages import State

VISITORS, MESSAGES = 5, 1000
"""A page reads 60 messages a second of each visitor."""
MOST = 100
"""Of numbers that are offered: a thousand robots would be spawned otherwise."""
LAST = "the_last"
"""Robot that is selected last."""
WITHIN_S = 60.0
NUMBERS = (0.0, -1.0, 0.5, 2.0, 3.0, 50.0, 1e300, math.nan, math.inf, -math.inf)
VALUES: tuple[object, ...] = (
    True,
    False,
    None,
    "",
    "r1",
    "x" * 999,
    [],
    {},
    b"\xff",
    2**63,
    [1.0] * 5,
    *NUMBERS,
)
Choices = random.Random


def choose_value(choices: Choices, control: dict[str, Any]) -> object:
    """Choose a value, which half of the times the control offers."""
    props = control["props"]
    if choices.random() < 0.5:
        return choices.choice(VALUES)
    if props.get("options"):
        return choices.choice(props["options"])
    if "min" in props and isinstance(control.get("value"), int | float):
        bounds = [one for one in (props["min"], props["max"]) if one is not None]
        return choices.choice([*(one for one in bounds if abs(one) <= MOST), control["value"]])
    if isinstance(control.get("value"), list | tuple):
        return [choices.choice(NUMBERS[:6]) for _ in control["value"]]
    return choices.choice((True, False, "r1", "made"))


def use_control(choices: Choices, user: PageUser) -> dict[str, object]:
    control = choices.choice(user.list_controls())
    updates = {choices.choice(("value", "value", "label")): choose_value(choices, control)}
    return {"kind": "GuiUpdateMessage", "uuid": control["uuid"], "updates": updates}


def hold_button(choices: Choices, user: PageUser) -> dict[str, object]:
    uuid = choices.choice(user.list_controls())["uuid"]
    hz = choices.choice((20.0, 20.0, 10.0, 0.0, math.nan))
    return {"kind": "GuiButtonHoldMessage", "uuid": uuid, "frequency": hz}


def run_command(choices: Choices, user: PageUser) -> dict[str, object]:
    uuid = choices.choice([*user.list_commands(), "none"])
    return {"kind": "CommandTriggerMessage", "uuid": uuid}


def click_scene(choices: Choices, _: PageUser) -> dict[str, object]:
    ray: dict[str, object] = {
        "ray_origin": [choices.choice(NUMBERS) for _ in range(3)],
        "ray_direction": [choices.choice(NUMBERS) for _ in range(3)],
        "modifier": choices.choice((None, "shift", "none")),
    }
    if choices.random() < 0.5:
        places = ((0.5, 0.5),)
        return {"kind": "ScenePointerMessage", "event_type": "click", "screen_pos": places, **ray}
    name = choices.choice(("/robots/0/0/0", "/robots/9", "/ground", ""))
    number = choices.choice((0, 1, 999, -1, None))
    more: dict[str, object] = {
        "name": name,
        "instance_index": number,
        "screen_pos": (0.5, 0.5),
        "owner": "",
    }
    return {"kind": "SceneNodeClickMessage", **more, **ray}


def drag_handles(choices: Choices, user: PageUser) -> dict[str, object]:
    kind = choices.choice(("DragStart", "Update", "DragEnd"))
    pose: dict[str, object] = {
        "wxyz": [choices.choice(NUMBERS) for _ in range(4)],
        "position": [choices.choice(NUMBERS) for _ in range(3)],
    }
    more: dict[str, object] = pose if kind == "Update" else {}
    return {
        "kind": f"TransformControls{kind}Message",
        "name": "/handles",
        "owner": user.owner,
        **more,
    }


def send_script_message(choices: Choices, _: PageUser) -> dict[str, object]:
    axes = {axis: choices.choice((-1.0, 0.0, 1.0, 7.0)) for axis in ("forward", "left", "turn")}
    messages: tuple[dict[str, object], ...] = (
        {"kind": "ZensimDrive", **axes},
        {"kind": "ZensimSelect", "entity": choices.choice(("r1", "r2", "", "x" * 300))},
        {"kind": "ZensimTheme", "is_dark": choices.choice((True, False, "dark"))},
        {"kind": "ZensimModel", "model": choices.choice(("box_bot", "car_bot", "none", ""))},
        {"kind": "ZensimLeave"},
        {"kind": "ZensimAct", "act": choices.choice(("Play", "Step", "Show all", "Explode"))},
        {"kind": "ZensimNothing"},
    )
    return choices.choice(messages)


KINDS: tuple[Callable[[Choices, PageUser], dict[str, object]], ...] = (
    *(use_control,) * 4,
    hold_button,
    run_command,
    click_scene,
    drag_handles,
    send_script_message,
)


def test_page_and_server_live_after_1000_random_messages() -> None:
    choices = random.Random(7)
    with serving() as server, viewing(server.endpoint) as (url, process):
        for name in ("r1", "r2"):
            assert server.zensim("spawn", "box_bot", "--name", name).returncode == 0
        with ExitStack() as stack:
            users = [stack.enter_context(PageUser(url)) for _ in range(VISITORS)]
            users[0].send("ZensimSelect", entity="r1")
            for number in range(MESSAGES):
                user = users[number % VISITORS]
                fields = choices.choice(KINDS)(choices, user)
                user.send(str(fields.pop("kind")), **fields)
            assert server.zensim("spawn", "box_bot", "--name", LAST).returncode == 0
            for user in users:
                user.wait_for_row(LAST)
                # All messages of a visitor before this one have been read.
                user.send("ZensimSelect", entity=LAST)
            eventually(lambda: list(map(has_last, users)) == [True] * VISITORS, WITHIN_S, "all")

        with PageUser(url) as last:
            eventually(lambda: is_played(server, last), WITHIN_S, "a live page")
            last.act("Pause")
            is_paused = lambda: server.client.simulation_state() == State.PAUSED  # noqa: E731
            eventually(is_paused, WITHIN_S, "a pause")
        process.send_signal(signal.SIGTERM)
        assert process.wait(END_S) == 0
        assert process.stderr is not None
        assert process.stderr.read() == ""


def is_played(server: Server, user: PageUser) -> bool:
    """Play what visitors have paused, some of them late; whether a page shows it."""
    with suppress(ServiceError):  # it is played already
        server.client.set_simulation_state(State.PLAYING)
    return "playing" in user.texts()


def has_last(user: PageUser) -> bool:
    """Whether the page has selected what was asked for last."""
    return any(f'zensimSelected(["{LAST}"])' in one for one in user.scripts[-20:])
