"""Cache of compiled models, shared by the engines of a process; larger ones are compiled ahead on a thread."""

from collections import OrderedDict
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Generic, TypeVar

from zensim.sim_server.physics.engine_config import EngineConfig
from zensim.sim_server.physics.mujoco.slot_layout import Archetype, SlotCounts

MAX_CACHED_MODELS = 24
PRECOMPILE_MIN_SLOTS, PRECOMPILE_MAX_SLOTS = 16, 256
"""Slots of a make: smaller casts take no time, and cells have no more."""

Made = TypeVar("Made")
CompileKey = tuple[SlotCounts, EngineConfig]


class CompileCache(Generic[Made]):
    """Keeps the casts that were used last: engines of a process that are alike share them."""

    def __init__(self, compile_cast: Callable[[SlotCounts, EngineConfig], Made]) -> None:
        """Get ready; `compile_cast` raises ValueError, and lets Python go on meanwhile."""
        self._compile = compile_cast
        self._compiled_models: OrderedDict[CompileKey, Future[Made]] = OrderedDict()
        self._thread = ThreadPoolExecutor(1, "casts")

    def is_ready(self, cast: SlotCounts, config: EngineConfig) -> bool:
        """Whether `cast` would not have to wait; else have it made besides."""
        return self._start((cast, config)).done()

    def compile(self, cast: SlotCounts, config: EngineConfig) -> Made:
        """Find a cast, or make it now; raises ValueError when it cannot be made."""
        key = cast, config
        if (known := self._compiled_models.get(key)) is None:
            known = self._compiled_models[key] = Future()
            _compile_into(known, self._compile, key)
        self._compiled_models.move_to_end(key)
        while len(self._compiled_models) > MAX_CACHED_MODELS:
            self._compiled_models.popitem(last=False)
        return known.result()

    def compile_ahead(self, cast: SlotCounts, make: Archetype, config: EngineConfig) -> None:
        """Have casts with twice and four times as many slots of a make made besides."""
        slots = dict(cast)[make]
        if slots < PRECOMPILE_MIN_SLOTS:
            return
        for count in (2 * slots, 4 * slots):
            if count <= PRECOMPILE_MAX_SLOTS:
                self._start((tuple({**dict(cast), make: count}.items()), config))

    def _start(self, key: CompileKey) -> "Future[Made]":
        if (known := self._compiled_models.get(key)) is None:
            known = self._compiled_models[key] = self._thread.submit(self._compile, *key)
        return known


def _compile_into(
    wanted: "Future[Made]",
    compile_cast: Callable[[SlotCounts, EngineConfig], Made],
    key: CompileKey,
) -> None:
    try:
        wanted.set_result(compile_cast(*key))
    except ValueError as error:
        wanted.set_exception(error)
