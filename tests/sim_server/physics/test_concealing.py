"""Bodies that wait out of sight until others are made too."""

from collections.abc import Iterator

import numpy as np
import pytest

from sim_server.physics.pybullet_engine import PyBulletEngine
from tests.engines import advance, running
from tests.models import a_box, a_box_bot, a_state, box_bot_at


@pytest.fixture
def engine() -> Iterator[PyBulletEngine]:
    with running(PyBulletEngine) as made:
        assert isinstance(made, PyBulletEngine)
        yield made


def test_concealed_body_stays_where_it_is_and_stops_nobody(engine: PyBulletEngine) -> None:
    hidden = engine.add(a_box(), a_state((0.0, 0.0, 0.5)))
    engine.conceal(hidden)
    falling = engine.add(a_box(), a_state((0.0, 0.0, 0.8)))

    advance(engine, 240)

    heights = engine.read([hidden, falling]).base[:, 2]
    assert heights == pytest.approx([0.5, 0.1], abs=1e-3)


def test_revealed_body_does_as_one_that_was_just_added(engine: PyBulletEngine) -> None:
    first = engine.add(a_box_bot(), box_bot_at(0.0, 2.0))
    engine.conceal(first)
    advance(engine, 50)

    engine.reveal([first])
    second = engine.add(a_box_bot(), box_bot_at())
    engine.command([first, second], np.full(4, 5.0))
    advance(engine, 240)

    one, other = engine.read([first, second]).base[:, :3]
    assert one[0] > 0.1
    assert one - other == pytest.approx(np.array([0.0, 2.0, 0.0]), abs=1e-3)


def test_concealed_body_overlaps_what_it_will_overlap(engine: PyBulletEngine) -> None:
    there = engine.add(a_box(), a_state((0.0, 0.0, 0.1)))
    hidden = engine.add(a_box(), a_state((0.1, 0.0, 0.1)))
    engine.conceal(hidden)

    assert list(engine.overlapping(hidden)) == [there]


def test_concealed_body_can_be_removed(engine: PyBulletEngine) -> None:
    hidden = engine.add(a_box_bot(), box_bot_at())
    engine.conceal(hidden)
    engine.remove(hidden)

    body = engine.add(a_box_bot(), box_bot_at(1.0))
    engine.command([body], np.full(2, 5.0))
    advance(engine, 240)

    assert engine.read([body]).base[0, 0] > 1.1
