"""Compiled models that are kept, and the next larger one, compiled in a thread."""

import os
from collections import OrderedDict
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Generic, TypeVar

from zensim.sim_server.physics.engine_config import EngineConfig
from zensim.sim_server.physics.mujoco.slot_layout import Archetype, SlotCounts

MAX_CACHED_MODELS = 24
COMPILE_THREAD = "mujoco-compile"
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
        self._thread = ThreadPoolExecutor(1, COMPILE_THREAD)
        self._process = os.getpid()

    def is_ready(self, counts: SlotCounts, config: EngineConfig) -> bool:
        """Whether `compile` would not wait; if not, start compiling on the thread."""
        return self._start((counts, config)).done()

    def compile(self, counts: SlotCounts, config: EngineConfig) -> Compiled:
        """Find or compile a model; raises ValueError if MuJoCo cannot compile it."""
        key = counts, config
        if (found := self._find(key)) is None:
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
        for more in (2 * slots, 4 * slots):
            if more <= PRECOMPILE_MAX_SLOTS:
                self._start((tuple({**dict(counts), archetype: more}.items()), config))

    def _find(self, key: CompileKey) -> "Future[Compiled] | None":
        if self._process != os.getpid():
            self._continue_in_copy()
        return self._compiled_models.get(key)

    def _continue_in_copy(self) -> None:
        """Replace the thread, which a copy of the process lacks, and forget what it had begun."""
        self._process, self._thread = os.getpid(), ThreadPoolExecutor(1, COMPILE_THREAD)
        for key, future in list(self._compiled_models.items()):
            if not future.done():
                del self._compiled_models[key]

    def _start(self, key: CompileKey) -> "Future[Compiled]":
        if (found := self._find(key)) is None:
            found = self._compiled_models[key] = self._thread.submit(self._compile, *key)
        return found


def _compile_into(
    future: "Future[Compiled]",
    compile_model: Callable[[SlotCounts, EngineConfig], Compiled],
    key: CompileKey,
) -> None:
    try:
        future.set_result(compile_model(*key))
    except Exception as error:  # noqa: BLE001 - or who asks again would wait for ever
        future.set_exception(error)
