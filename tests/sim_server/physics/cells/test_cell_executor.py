"""Cells in worker processes, or stepped by threads, give the results of one thread."""

import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager

import msgspec
import numpy as np
import psutil
import pytest

from tests.engines import STEP_NS, advance
from tests.integration.processes import eventually
from tests.models import a_box, a_cart, a_fork, a_puck, a_state, an_arm, on_ground
from tests.page_faults import PAGE_BYTES, count_page_faults
from zensim.sim_server.physics.cells.cell_executor import InProcessCellExecutor, WorkerCellExecutor
from zensim.sim_server.physics.cells.cell_worker_client import CellWorkerDied, RemoteCell
from zensim.sim_server.physics.cells.celled_engine import CelledEngine, CellSettings
from zensim.sim_server.physics.engine import Engine, EngineRefused
from zensim.sim_server.physics.engine_config import EngineConfig
from zensim.sim_server.physics.engine_factory import NEW_CELL_BYTES, CellConfig

SETTINGS = CellSettings(single_cell_bodies=2, cell_bodies=3, period_steps=3)
ORDERS = CellConfig("pybullet", EngineConfig(STEP_NS))


@contextmanager
def with_workers(workers: int) -> Iterator[tuple[CelledEngine, WorkerCellExecutor]]:
    cells = WorkerCellExecutor(ORDERS.make, ORDERS, workers=workers)
    engine = CelledEngine(ORDERS.config, cells, SETTINGS)
    try:
        yield engine, cells
    finally:
        engine.close()


@contextmanager
def in_process(orders: CellConfig = ORDERS, *, threads: int = 1) -> Iterator[CelledEngine]:
    cells = InProcessCellExecutor(orders.make, threads=threads)
    engine = CelledEngine(orders.config, cells, SETTINGS)
    try:
        yield engine
    finally:
        engine.close()


def drive_mixed_robots(engine: Engine) -> bytes:
    """Drive robots of all kinds among walls for 2 s; push, move and remove some."""
    draws, model = np.random.default_rng(3), a_cart()
    engine.add(a_box(side_m=0.5, is_static=True), a_state((0.0, 0.0, 0.25)))
    places = draws.uniform(-2.0, 2.0, (12, 2)).tolist()
    bodies = [engine.add(model, on_ground(x, y)) for x, y in places]
    others = [
        engine.add(a_puck(), a_state((3.0, 1.0, 0.0))),
        engine.add(a_fork(), a_state((-3.0, 1.0, 0.0))),
        engine.add(an_arm("prismatic"), a_state((-3.0, -3.0, 0.0))),
    ]
    crowd = tuple(bodies[1:] + others)
    engine.remove(bodies[0])
    for turn in range(40):
        engine.command(crowd, draws.uniform(-6.0, 6.0, 22 + 3 + 2))
        engine.apply_link_wrench(bodies[2], 0, draws.uniform(-20.0, 20.0, 6))
        engine.apply_joint_effort(bodies[3], 0, 0.1)
        if turn == 20:
            engine.set_at_rest(bodies[4], on_ground(5.0, 5.0), np.array([0.1, 0.2]))
            engine.set_state(
                bodies[5], on_ground(5.0, -5.0), np.array([0.1, 0.2]), np.array([5.0, 5.0])
            )
            engine.set_base_state(bodies[6], on_ground(-5.0, 5.0))
        advance(engine, 12)
    touching = [list(engine.find_overlaps(body)) for body in crowd]
    reading = engine.read(crowd)
    efforts = engine.read_joint_efforts(crowd)
    assert np.isfinite(efforts).all()
    assert efforts.any()
    few = [engine.read_joint_efforts(crowd[at : at + 1]) for at in range(len(crowd))]
    assert np.concatenate(few).tobytes() == efforts.tobytes()
    arrays = (reading.base, reading.joint_positions, reading.joint_velocities, efforts)
    return b"".join(array.tobytes() for array in arrays) + repr(touching).encode()


@pytest.mark.parametrize("workers", [1, 2])
def test_workers_give_the_bits_of_one_process(workers: int) -> None:
    with in_process() as alone, with_workers(workers) as (shared, cells):
        assert drive_mixed_robots(shared) == drive_mixed_robots(alone)

        assert len(cells.process_ids) == workers


@pytest.mark.parametrize("threads", [2, 3])
def test_threads_give_the_bits_of_one_thread(threads: int) -> None:
    orders = CellConfig("mujoco", EngineConfig(STEP_NS))

    with in_process(orders) as alone, in_process(orders, threads=threads) as shared:
        assert drive_mixed_robots(shared) == drive_mixed_robots(alone)


def test_workers_are_not_started_for_one_cell() -> None:
    with with_workers(2) as (engine, cells):
        for x in (0.0, 5.0):
            engine.add(a_cart(), on_ground(x))
        advance(engine, 5)

        assert cells.process_ids == []


def test_workers_end_with_the_engine() -> None:
    with with_workers(1) as (engine, cells):
        for x in range(4):
            engine.add(a_cart(), on_ground(5.0 * x))
        engine.step()
        (worker,) = cells.process_ids
        assert psutil.pid_exists(worker)

    assert not psutil.pid_exists(worker)


def test_death_of_a_worker_is_raised_in_the_next_step() -> None:
    with with_workers(1) as (engine, cells):
        for x in range(4):
            engine.add(a_cart(), on_ground(5.0 * x))
        engine.step()

        os.kill(cells.process_ids[0], signal.SIGKILL)

        with pytest.raises(CellWorkerDied):
            advance(engine, 2)


def test_worker_continues_after_its_engine_refused_a_call() -> None:
    with with_workers(1) as (engine, _):
        carts = tuple(engine.add(a_cart(), on_ground(5.0 * x)) for x in range(8))
        strange = msgspec.structs.replace(a_cart(), links=an_arm("planar").links)
        strange = msgspec.structs.replace(strange, joints=an_arm("planar").joints, drive=None)

        for x in range(8):
            with pytest.raises(EngineRefused, match="planar"):
                engine.add(strange, on_ground(5.0 * x, 1.0))

        engine.command(carts, np.full(16, 4.0))
        advance(engine, 240)
        assert engine.read(carts).base[:, 0] == pytest.approx(
            [5.0 * x + 0.2 for x in range(8)], abs=0.03
        )


def test_adding_bodies_does_not_wait_for_a_stopped_worker() -> None:
    model = a_cart()
    with with_workers(1) as (engine, cells):
        bodies = [engine.add(model, on_ground(5.0 * x)) for x in range(4)]
        engine.step()
        (worker,) = cells.process_ids
        os.kill(worker, signal.SIGSTOP)
        try:
            bodies += [engine.add(model, on_ground(5.0 * x)) for x in range(4, 40)]
            overlapped = [engine.find_overlaps(body) for body in bodies[-5:]]
            was_settled = engine.is_idle()
        finally:
            os.kill(worker, signal.SIGCONT)

        assert not was_settled
        assert [list(found) for found in overlapped] == [[]] * 5
        assert eventually(engine.is_idle, 30.0)
        assert engine.read(bodies).base[:, 0] == pytest.approx([5.0 * x for x in range(40)])


def test_async_overlaps_are_those_of_the_call() -> None:
    model = a_cart()
    with with_workers(1) as (engine, _):
        bodies = [engine.add(model, on_ground(0.05 * x, 5.0 * (x // 2))) for x in range(8)]
        soon = [engine.find_overlaps_async(body) for body in bodies]

        assert [list(named()) for named in soon] == [list(engine.find_overlaps(b)) for b in bodies]
        assert any(named() for named in soon)


def test_workers_start_before_the_second_cell_is_needed() -> None:
    cells = WorkerCellExecutor(ORDERS.make, ORDERS, workers=1)
    engine = CelledEngine(ORDERS.config, cells, CellSettings(single_cell_bodies=10, cell_bodies=10))
    try:
        for x in range(9):
            engine.add(a_cart(), on_ground(5.0 * x))
        before = list(cells.process_ids)
        engine.add(a_cart(), on_ground(-5.0))

        assert before == []
        assert len(cells.process_ids) == 1
    finally:
        engine.close()


def test_cell_of_this_process_that_was_prepared_causes_few_page_faults() -> None:
    size = NEW_CELL_BYTES["pybullet"]
    cells = WorkerCellExecutor(ORDERS.make, ORDERS, workers=1, cell_bytes=size)
    made = [cells.make() for _ in range(3)]
    try:
        cells.start()
        faults = count_page_faults(lambda: made.append(cells.make()))

        assert not isinstance(made[-1], RemoteCell)
        assert faults < size // PAGE_BYTES // 2
    finally:
        for cell in made:
            cells.end(cell)
        cells.close()


def test_cells_are_shared_evenly_again_after_others_ended() -> None:
    cells = WorkerCellExecutor(ORDERS.make, ORDERS, workers=1)
    try:
        first = [cells.make() for _ in range(4)]
        for cell in first[1:]:
            cells.end(cell)
        again = [first[0], *(cells.make() for _ in range(3))]

        assert [isinstance(cell, RemoteCell) for cell in first] == [False, True, True, False]
        assert [isinstance(cell, RemoteCell) for cell in again] == [False, True, True, False]
        for cell in again:
            cells.end(cell)
    finally:
        cells.close()
