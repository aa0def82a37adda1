"""Compiled casts, each made once for a process, and the next larger ones made ahead by a thread."""

from collections import OrderedDict
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Generic, TypeVar

from zensim.sim_server.physics.casting.make import Make
from zensim.sim_server.physics.casting.slots import Cast
from zensim.sim_server.physics.engine import EngineConfig

KEPT = 24
AHEAD_FROM, AHEAD_TO = 16, 256
"""Slots of a make: smaller casts take no time, and cells have no more."""

Made = TypeVar("Made")
Key = tuple[Cast, EngineConfig]


class Foundry(Generic[Made]):
    """Keeps the casts that were used last: engines of a process that are alike share them."""

    def __init__(self, compile_cast: Callable[[Cast, EngineConfig], Made]) -> None:
        """Get ready; `compile_cast` raises ValueError, and lets Python go on meanwhile."""
        self._compile = compile_cast
        self._made: OrderedDict[Key, Future[Made]] = OrderedDict()
        self._thread = ThreadPoolExecutor(1, "casts")

    def is_ready(self, cast: Cast, config: EngineConfig) -> bool:
        """Whether `cast` would not have to wait; else have it made besides."""
        return self._begin((cast, config)).done()

    def cast(self, cast: Cast, config: EngineConfig) -> Made:
        """Find a cast, or make it now; raises ValueError when it cannot be made."""
        key = cast, config
        if (known := self._made.get(key)) is None:
            known = self._made[key] = Future()
            _fulfil(known, self._compile, key)
        self._made.move_to_end(key)
        while len(self._made) > KEPT:
            self._made.popitem(last=False)
        return known.result()

    def make_ahead(self, cast: Cast, make: Make, config: EngineConfig) -> None:
        """Have casts with twice and four times as many slots of a make made besides."""
        slots = dict(cast)[make]
        if slots < AHEAD_FROM:
            return
        for count in (2 * slots, 4 * slots):
            if count <= AHEAD_TO:
                self._begin((tuple({**dict(cast), make: count}.items()), config))

    def _begin(self, key: Key) -> "Future[Made]":
        if (known := self._made.get(key)) is None:
            known = self._made[key] = self._thread.submit(self._compile, *key)
        return known


def _fulfil(
    wanted: "Future[Made]", compile_cast: Callable[[Cast, EngineConfig], Made], key: Key
) -> None:
    try:
        wanted.set_result(compile_cast(*key))
    except ValueError as error:
        wanted.set_exception(error)
