"""Casts are made once, by whoever asks first, and the larger ones besides."""

from threading import Event, get_ident

import pytest

from tests.engines import STEP_NS
from tests.integration.processes import eventually
from zensim.sim_server.physics.engine_config import EngineConfig
from zensim.sim_server.physics.mujoco.compile_cache import CompileCache
from zensim.sim_server.physics.mujoco.slot_layout import Archetype, SlotCounts

CONFIG = EngineConfig(STEP_NS)
MAKE = Archetype((), (), is_static=False)
WITHIN_S = 10.0


class Workshop:
    """Says which casts were made, and by which threads."""

    def __init__(self) -> None:
        self.made: list[int] = []
        self.threads: set[int] = set()
        self.may_go_on = Event()
        self.may_go_on.set()

    def make(self, cast: SlotCounts, _: EngineConfig) -> int:
        self.may_go_on.wait(WITHIN_S)
        self.threads.add(get_ident())
        self.made.append(cast[0][1])
        if cast[0][1] == 13:
            raise ValueError("unlucky")
        return cast[0][1]


def of(slots: int) -> SlotCounts:
    return ((MAKE, slots),)


def test_cast_is_made_once_by_who_asks() -> None:
    shop = Workshop()
    foundry = CompileCache(shop.make)

    found = [foundry.compile(of(4), CONFIG) for _ in range(2)]

    assert found == [4, 4]
    assert shop.made == [4]
    assert shop.threads == {get_ident()}


def test_what_is_not_ready_is_made_besides() -> None:
    shop = Workshop()
    foundry = CompileCache(shop.make)
    shop.may_go_on.clear()

    assert not foundry.is_ready(of(8), CONFIG)

    shop.may_go_on.set()
    eventually(lambda: foundry.is_ready(of(8), CONFIG) or None, WITHIN_S, "a cast")
    assert foundry.compile(of(8), CONFIG) == 8
    assert shop.made == [8]
    assert get_ident() not in shop.threads


def test_larger_casts_are_made_ahead_as_far_as_cells_go() -> None:
    shop = Workshop()
    foundry = CompileCache(shop.make)

    for slots in (8, 32, 128, 256):
        foundry.compile_ahead(of(slots), MAKE, CONFIG)

    assert foundry.compile(of(256), CONFIG) == 256
    assert shop.made == [64, 128, 256]


def test_what_cannot_be_made_is_refused_to_everybody() -> None:
    foundry = CompileCache(Workshop().make)

    for _ in range(2):
        with pytest.raises(ValueError, match="unlucky"):
            foundry.compile(of(13), CONFIG)
    assert foundry.is_ready(of(13), CONFIG)
