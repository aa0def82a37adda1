"""Cache of compiled models, shared in a process; larger ones are compiled ahead on a thread."""

from collections import OrderedDict
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Generic, TypeVar

from zensim.sim_server.physics.engine_config import EngineConfig
from zensim.sim_server.physics.mujoco.slot_layout import Archetype, SlotCounts

MAX_CACHED_MODELS = 24
PRECOMPILE_MIN_SLOTS, PRECOMPILE_MAX_SLOTS = 16, 256
"""Slots of an archetype: fewer compile fast, and cells have no more."""

Compiled = TypeVar("Compiled")
CompileKey = tuple[SlotCounts, EngineConfig]


class CompileCache(Generic[Compiled]):
    """Least recently used cache of compiled models, shared by the engines of a process."""

    def __init__(self, compile_model: Callable[[SlotCounts, EngineConfig], Compiled]) -> None:
        """Make a cache; `compile_model` raises ValueError, and releases the interpreter's lock."""
        self._compile = compile_model
        self._compiled_models: OrderedDict[CompileKey, Future[Compiled]] = OrderedDict()
        self._thread = ThreadPoolExecutor(1, "mujoco-compile")

    def is_ready(self, counts: SlotCounts, config: EngineConfig) -> bool:
        """Whether `compile` would not wait; if not, start compiling on the thread."""
        return self._start((counts, config)).done()

    def compile(self, counts: SlotCounts, config: EngineConfig) -> Compiled:
        """Find or compile a model; raises ValueError if MuJoCo cannot compile it."""
        key = counts, config
        if (found := self._compiled_models.get(key)) is None:
            found = self._compiled_models[key] = Future()
            _compile_into(found, self._compile, key)
        self._compiled_models.move_to_end(key)
        while len(self._compiled_models) > MAX_CACHED_MODELS:
            self._compiled_models.popitem(last=False)
        return found.result()

    def compile_ahead(self, counts: SlotCounts, archetype: Archetype, config: EngineConfig) -> None:
        """Start compiling models with twice and four times the slots of an archetype."""
        slots = dict(counts)[archetype]
        if slots < PRECOMPILE_MIN_SLOTS:
            return
        for count in (2 * slots, 4 * slots):
            if count <= PRECOMPILE_MAX_SLOTS:
                self._start((tuple({**dict(counts), archetype: count}.items()), config))

    def _start(self, key: CompileKey) -> "Future[Compiled]":
        if (found := self._compiled_models.get(key)) is None:
            found = self._compiled_models[key] = self._thread.submit(self._compile, *key)
        return found


def _compile_into(
    future: "Future[Compiled]",
    compile_model: Callable[[SlotCounts, EngineConfig], Compiled],
    key: CompileKey,
) -> None:
    try:
        future.set_result(compile_model(*key))
    except ValueError as error:
        future.set_exception(error)
