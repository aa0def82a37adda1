import math

import numpy as np
import pytest

from zensim.proto.codec.cdr_reader import MalformedPayload
from zensim.proto.messages.agent_messages import TwistCommands
from zensim.sim_server.world.commanded_twists import CommandedTwists
from zensim.sim_server.world.entity import EntityIndex

NAN = math.nan


def an_index(*names: str) -> EntityIndex:
    counts = np.zeros(len(names), dtype=np.intp)
    rows = {name: row for row, name in enumerate(names)}
    return EntityIndex(names, tuple(range(len(names))), rows, counts, counts)


def orders(rows: dict[str, tuple[float, float, float]], client: str = "c1") -> TwistCommands:
    return TwistCommands(client, tuple(rows), np.array(list(rows.values()), dtype="<f8").tobytes())


def selected(twists: CommandedTwists, index: EntityIndex) -> list[list[float]]:
    rows = np.arange(len(index.names), dtype=np.intp)
    return np.frombuffer(twists.select(index, rows), dtype="<f8").reshape(-1, 3).tolist()


def test_nothing_is_selected_before_the_first_order() -> None:
    assert selected(CommandedTwists(), an_index("r1")) == []


def test_order_holds_for_its_entity_only() -> None:
    twists, index = CommandedTwists(), an_index("r1", "r2")

    twists.order(index, orders({"r2": (0.2, 0.0, 0.5), "gone": (1.0, 1.0, 1.0)}))

    first, second = selected(twists, index)
    assert second == [0.2, 0.0, 0.5]
    assert all(map(math.isnan, first))


def test_order_follows_its_entity_to_another_row() -> None:
    twists, index = CommandedTwists(), an_index("r1", "r2")
    twists.order(index, orders({"r2": (0.2, 0.0, 0.5)}))

    assert selected(twists, an_index("r2")) == [[0.2, 0.0, 0.5]]


def test_displaced_order_holds_again_when_the_newer_is_released() -> None:
    twists, index = CommandedTwists(), an_index("r1", "r2")
    twists.order(index, orders({"r1": (0.2, 0.0, 0.0), "r2": (0.2, 0.0, 0.0)}, "c1"))
    twists.order(index, orders({"r1": (-0.1, 0.0, 0.0), "r2": (-0.1, 0.0, 0.0)}, "c2"))
    twists.order(index, orders({"r1": (0.3, 0.0, 0.0), "r2": (0.3, 0.0, 0.0)}, "c1"))

    twists.order(index, orders({"r1": (NAN, NAN, NAN)}, "c1"))

    assert selected(twists, index) == [[-0.1, 0.0, 0.0], [0.3, 0.0, 0.0]]
    twists.end_client("c1")
    assert selected(twists, index) == [[-0.1, 0.0, 0.0], [-0.1, 0.0, 0.0]]


def test_displaced_order_that_was_released_does_not_hold_again() -> None:
    twists, index = CommandedTwists(), an_index("r1", "r2")
    twists.order(index, orders({"r1": (0.2, 0.0, 0.0), "r2": (0.2, 0.0, 0.0)}, "c1"))
    twists.order(index, orders({"r1": (-0.1, 0.0, 0.0), "r2": (-0.1, 0.0, 0.0)}, "c2"))
    twists.order(index, orders({"r1": (NAN, NAN, NAN)}, "c1"))
    twists.end_client("c1")

    twists.order(index, orders({"r1": (NAN, NAN, NAN), "r2": (NAN, NAN, NAN)}, "c2"))

    assert selected(twists, index) == []


def test_nan_keeps_what_another_client_ordered_later() -> None:
    twists, index = CommandedTwists(), an_index("r1", "r2")
    twists.order(index, orders({"r1": (0.2, 0.0, 0.0), "r2": (0.2, 0.0, 0.0)}, "c1"))
    twists.order(index, orders({"r2": (-0.1, 0.0, 0.0)}, "c2"))

    twists.order(index, orders({"r1": (NAN, NAN, NAN), "r2": (NAN, NAN, NAN)}, "c1"))

    first, second = selected(twists, index)
    assert all(map(math.isnan, first))
    assert second == [-0.1, 0.0, 0.0]
    twists.end_client("c1")
    assert selected(twists, index)[1] == [-0.1, 0.0, 0.0]


def test_nan_releases() -> None:
    twists, index = CommandedTwists(), an_index("r1")
    twists.order(index, orders({"r1": (0.2, 0.0, 0.5)}))

    twists.order(index, orders({"r1": (NAN, NAN, NAN)}))

    assert selected(twists, index) == []


def test_robots_of_a_client_that_has_gone_stop_once_and_are_released() -> None:
    twists, index = CommandedTwists(), an_index("r1", "r2")
    twists.order(index, orders({"r1": (0.2, 0.0, 0.5)}, "c1"))
    twists.order(index, orders({"r2": (0.3, 0.0, 0.0)}, "c2"))

    twists.end_client("c1")
    ended = selected(twists, index)
    twists.note_published()

    assert ended == [[0.0, 0.0, 0.0], [0.3, 0.0, 0.0]]
    assert math.isnan(selected(twists, index)[0][0])


def test_entity_of_a_deleted_name_has_no_order() -> None:
    twists, index = CommandedTwists(), an_index("r1")
    twists.order(index, orders({"r1": (0.2, 0.0, 0.5)}))

    twists.forget("r1")

    assert selected(twists, an_index("r1")) == []


@pytest.mark.parametrize("payload", [b"", b"1234", np.full(3, np.inf).tobytes()])
def test_order_that_does_not_fit_is_refused(payload: bytes) -> None:
    with pytest.raises(MalformedPayload):
        CommandedTwists().order(an_index("r1"), TwistCommands("c1", ("r1",), payload))
