"""Models are compiled once, ahead, and by a thread; failures reach each caller."""

from threading import Event, get_ident

import pytest

from tests.engines import STEP_NS
from tests.integration.processes import eventually
from tests.sim_server.physics.mujoco import compiling_copy
from zensim.proto.child_process import make_module_command, run_process
from zensim.sim_server.physics.engine_config import EngineConfig
from zensim.sim_server.physics.mujoco.compile_cache import CompileCache
from zensim.sim_server.physics.mujoco.slot_layout import Archetype, SlotCounts

CONFIG = EngineConfig(STEP_NS)
ARCHETYPE = Archetype((), (), is_static=False)
WITHIN_S = 10.0
ENDS_S = 120.0
"""A copy that waits for a thread which it lacks never ends."""


class RecordingCompiler:
    """Records which models were compiled, and by which threads."""

    def __init__(self) -> None:
        self.compiled: list[int] = []
        self.threads: set[int] = set()
        self.may_continue = Event()
        self.may_continue.set()

    def compile(self, counts: SlotCounts, _: EngineConfig) -> int:
        self.may_continue.wait(WITHIN_S)
        self.threads.add(get_ident())
        self.compiled.append(counts[0][1])
        if counts[0][1] == 13:
            raise ValueError("invalid")
        if counts[0][1] == 26:
            raise OSError("gone")
        return counts[0][1]


def counts_of(slots: int) -> SlotCounts:
    return ((ARCHETYPE, slots),)


def test_model_is_compiled_once_by_the_caller() -> None:
    compiler = RecordingCompiler()
    cache = CompileCache(compiler.compile)

    found = [cache.compile(counts_of(4), CONFIG) for _ in range(2)]

    assert found == [4, 4]
    assert compiler.compiled == [4]
    assert compiler.threads == {get_ident()}


def test_missing_model_is_compiled_on_the_thread() -> None:
    compiler = RecordingCompiler()
    cache = CompileCache(compiler.compile)
    compiler.may_continue.clear()

    assert not cache.is_ready(counts_of(8), CONFIG)

    compiler.may_continue.set()
    eventually(lambda: cache.is_ready(counts_of(8), CONFIG) or None, WITHIN_S, "compilation")
    assert cache.compile(counts_of(8), CONFIG) == 8
    assert compiler.compiled == [8]
    assert get_ident() not in compiler.threads


def test_larger_models_are_compiled_ahead_up_to_the_cell_size() -> None:
    compiler = RecordingCompiler()
    cache = CompileCache(compiler.compile)

    for slots in (8, 32, 128, 256):
        cache.compile_ahead(counts_of(slots), ARCHETYPE, CONFIG)

    assert cache.compile(counts_of(256), CONFIG) == 256
    assert compiler.compiled == [64, 128, 256]


def test_copy_of_a_process_compiles_what_the_thread_had_begun() -> None:
    done = run_process(make_module_command(compiling_copy.__name__), b"", timeout_s=ENDS_S)

    assert (done.status, done.output) == (0, b"4 8")


def test_failed_compilation_raises_for_each_caller() -> None:
    cache = CompileCache(RecordingCompiler().compile)

    for _ in range(2):
        with pytest.raises(ValueError, match="invalid"):
            cache.compile(counts_of(13), CONFIG)
    assert cache.is_ready(counts_of(13), CONFIG)


def test_unexpected_failure_of_a_compilation_keeps_no_caller_waiting() -> None:
    cache = CompileCache(RecordingCompiler().compile)

    for _ in range(2):
        with pytest.raises(OSError, match="gone"):
            cache.compile(counts_of(26), CONFIG)
