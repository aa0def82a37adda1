"""A celled engine gives the contacts and results of one engine."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial

import numpy as np
import pytest

from tests.engines import STEP_NS, ObedientEngine, advance, running
from tests.models import a_box, a_box_bot, a_cart, a_state, box_bot_at, on_ground
from zensim.proto.messages.model_messages import Link, Model, Shape
from zensim.sim_server.physics.bullet.pybullet_engine import PyBulletEngine
from zensim.sim_server.physics.cells.cell_executor import CellReadRequest, InProcessCellExecutor
from zensim.sim_server.physics.cells.celled_engine import CelledEngine, CellSettings
from zensim.sim_server.physics.engine import BodyStates, Engine, FloatArray, Place
from zensim.sim_server.physics.engine_config import EngineConfig

SINGLE_BODIES = CellSettings(single_cell_bodies=1, cell_bodies=1, period_steps=3)
"""Each body has a cell of its own unless it may touch another."""
PERIOD = 3


class CountedCells(InProcessCellExecutor):
    """Counts the cells of each step, and the readings of all bodies."""

    def __init__(self, make: Callable[[], Engine]) -> None:
        super().__init__(make)
        self.stepped: list[int] = []
        self.readings = 0

    def read(self, requests: Sequence[CellReadRequest]) -> list[BodyStates]:
        self.readings += 1
        return super().read(requests)

    def step(self, cells: Sequence[Engine], steps: int) -> bool:
        self.stepped.append(len(cells))
        return super().step(cells, steps)


@contextmanager
def celled(
    settings: CellSettings = SINGLE_BODIES, config: EngineConfig | None = None
) -> Iterator[tuple[CelledEngine, CountedCells]]:
    chosen = config or EngineConfig(STEP_NS)
    cells = CountedCells(partial(PyBulletEngine, chosen, awake=2))
    engine = CelledEngine(chosen, cells, settings)
    try:
        yield engine, cells
    finally:
        engine.close()


def nearest(places: FloatArray) -> float:
    apart = np.linalg.norm(places[:, None] - places[None], axis=2)
    return float(apart[np.triu_indices(len(places), 1)].min())


def closest_while_driving(engine: Engine, starts: list[FloatArray], steps: int) -> list[float]:
    """Drive carts straight ahead; list the least distance of two at each control period."""
    model = a_cart()
    bodies = tuple(engine.add(model, start) for start in starts)
    found = []
    for _ in range(steps // PERIOD):
        engine.command(bodies, np.full(2 * len(bodies), 12.0))
        advance(engine, PERIOD)
        found.append(nearest(engine.read(bodies).base[:, :2]))
    return found


def head_on() -> list[FloatArray]:
    return [
        on_ground(side * 0.8, 3.0 * lane + 0.02 * side, 0.0 if side < 0 else np.pi)
        for lane in range(4)
        for side in (-1, 1)
    ]


def a_ring(count: int, radius_m: float) -> list[FloatArray]:
    """Place carts around the centre, facing it."""
    turns = np.arange(count) * 2.0 * np.pi / count
    return [
        on_ground(r * np.cos(turn), r * np.sin(turn), turn + np.pi)
        for turn, r in zip(turns, radius_m * (1.0 + np.arange(count) % 2), strict=True)
    ]


@pytest.mark.parametrize(
    ("starts", "steps", "most"),
    [(head_on(), 600, 1), (a_ring(50, 1.7), 600, 4)],
    ids=["head-on", "pile"],
)
def test_carts_do_not_pass_through_each_other(
    starts: list[FloatArray], steps: int, most: int
) -> None:
    with running(PyBulletEngine) as one:
        in_one = closest_while_driving(one, starts, steps)
    with celled(CellSettings(single_cell_bodies=most, cell_bodies=most, period_steps=PERIOD)) as (
        engine,
        cells,
    ):
        in_many = closest_while_driving(engine, starts, steps)

    assert min(in_one) < 0.35
    assert min(in_many) > min(in_one) - 0.03
    assert max(cells.stepped) >= len(starts) // most
    assert cells.stepped[-1] < max(cells.stepped)


def test_carts_that_meet_keep_their_order() -> None:
    with celled() as (engine, _):
        closest_while_driving(engine, head_on(), 1200)

        x = engine.read(range(8)).base[:, 0]

    assert (x[0::2] < x[1::2]).all()


def test_thrown_box_hits_a_box_of_another_cell() -> None:
    def thrown(engine: Engine) -> FloatArray:
        target = engine.add(a_box(), a_state((5.0, 0.0, 0.1)))
        engine.add(a_box(), a_state((0.0, 0.0, 0.1)))
        advance(engine, 20)
        engine.add(a_box(side_m=0.15), a_state((0.5, 0.02, 0.15), linear=(25.0, 0.0, 0.5)))
        advance(engine, 240)
        return np.asarray(engine.read([target]).base[0])

    with running(PyBulletEngine) as one, celled() as (many, _):
        assert thrown(one)[0] > 5.2
        assert thrown(many)[0] == pytest.approx(thrown(one)[0], rel=0.2)


def test_pushed_box_hits_a_box_of_another_cell() -> None:
    with celled() as (engine, _):
        target = engine.add(a_box(), a_state((1.5, 0.0, 0.1)))
        pushed = engine.add(a_box(), a_state((0.0, 0.0, 0.1)))
        advance(engine, 30)

        engine.apply_link_wrench(pushed, 0, np.array([6000.0, 0.0, 0.0, 0.0, 0.0, 0.0]))
        advance(engine, 120)

        assert engine.read([target]).base[0, 0] > 1.6


def test_wall_stops_carts_of_all_cells() -> None:
    with celled() as (engine, cells):
        carts = tuple(engine.add(a_cart(), on_ground(0.0, 5.0 * i)) for i in range(4))
        engine.add(a_box(side_m=1.0, is_static=True), a_state((1.0, 0.0, 0.5)))
        wall = engine.add(a_box(side_m=1.0, is_static=True), a_state((1.0, 10.0, 0.5)))
        engine.command(carts, np.full(8, 8.0))
        advance(engine, 900)
        stopped = engine.read(carts).base[:, 0]
        engine.set_base_state(wall, a_state((30.0, 10.0, 0.5)))
        advance(engine, 900)
        freed = engine.read(carts).base[:, 0]

    assert max(cells.stepped) == 4
    assert (stopped[[0, 2]] < 0.5).all()
    assert (stopped[[1, 3]] > 1.0).all()
    assert freed[0] < 0.5
    assert freed[2] > 1.0


def test_joints_and_targets_move_with_a_cart_to_another_cell() -> None:
    with running(PyBulletEngine) as one, celled() as (many, cells):
        rows = []
        for engine in (one, many):
            pair = tuple(engine.add(a_cart(), on_ground(0.0, y)) for y in (0.0, 0.55))
            engine.command(pair, np.array([6.0, 7.0, 7.0, 6.0]))
            advance(engine, 360)
            reading = engine.read(pair)
            rows.append((reading.base, reading.joint_positions, reading.joint_velocities))

    assert {cells.stepped[0], cells.stepped[-1]} == {1, 2}
    for found, expected in zip(rows[1], rows[0], strict=True):
        assert found == pytest.approx(expected, abs=2e-3)


def test_one_cell_gives_the_bits_of_one_engine() -> None:
    def driven(engine: Engine) -> bytes:
        bodies = tuple(engine.add(a_box_bot(), box_bot_at(0.2 * i)) for i in range(6))
        draws = np.random.default_rng(1)
        for _ in range(30):
            engine.command(bodies, draws.uniform(-8.0, 8.0, 12))
            advance(engine, 8)
        engine.remove(bodies[2])
        advance(engine, 30)
        left = (*bodies[:2], *bodies[3:])
        reading = engine.read(left)
        return reading.base.tobytes() + reading.joint_positions.tobytes()

    with running(PyBulletEngine) as one, celled(CellSettings()) as (many, cells):
        assert driven(many) == driven(one)

    assert not cells.stepped


def drive_crowd(engine: Engine) -> bytes:
    draws, model = np.random.default_rng(7), a_cart()
    places = draws.uniform(-2.0, 2.0, (20, 2))
    bodies = tuple(engine.add(model, on_ground(x, y)) for x, y in places.tolist())
    for _ in range(40):
        engine.command(bodies, draws.uniform(-10.0, 10.0, 40))
        advance(engine, 12)
    reading = engine.read(bodies)
    for body in bodies:
        engine.remove(body)
    return reading.base.tobytes() + reading.joint_positions.tobytes()


def test_same_calls_give_the_same_bits() -> None:
    settings = CellSettings(single_cell_bodies=4, cell_bodies=4, period_steps=3)
    with celled(settings) as (first, _), celled(settings) as (second, _):
        expected = drive_crowd(first)

        assert drive_crowd(second) == expected

        first.forget_removed()
        assert drive_crowd(first) == expected


def test_diverged_body_does_not_affect_other_cells() -> None:
    with celled() as (engine, _):
        bodies = tuple(engine.add(a_cart(), on_ground(5.0 * i)) for i in range(3))
        advance(engine, 10)
        engine.set_base_state(bodies[1], np.full(13, np.nan))

        succeeded = [engine.step() for _ in range(20)]

        base = engine.read(bodies).base
        assert not all(succeeded)
        assert np.isfinite(base[[0, 2]]).all()
        engine.remove(bodies[1])
        engine.command((bodies[0],), np.array([4.0, 4.0]))
        advance(engine, 240)
        assert engine.read((bodies[0],)).base[0, 0] == pytest.approx(0.2, abs=0.03)


def test_bodies_that_moved_before_the_first_regrouping_do_not_alert() -> None:
    settings = CellSettings(single_cell_bodies=2, cell_bodies=2, period_steps=PERIOD)
    with celled(settings) as (engine, cells):
        pair = tuple(engine.add(a_cart(), on_ground(0.0, y)) for y in (0.0, 5.0))
        engine.command(pair, np.full(4, 8.0))
        advance(engine, 240)
        engine.add(a_cart(), on_ground(-20.0))
        cells.readings = 0

        advance(engine, 60)

        assert len(cells.stepped) == 60
        assert 1 < cells.readings <= 2 + 60 // PERIOD


def test_body_that_is_hidden_after_its_overlaps_were_found_is_left_out_of_the_next_step() -> None:
    with celled() as (engine, _):
        shown, hidden = (engine.add(a_box(), a_state((5.0 * i, 0.0, 0.1))) for i in range(2))

        overlapped = engine.find_overlaps_async(hidden)
        engine.hide(hidden)
        advance(engine, 10)

        assert list(overlapped()) == []
        assert engine.read((shown,)).base[0, 0] == pytest.approx(0.0, abs=1e-3)


def test_overlaps_across_cells_are_found() -> None:
    with celled() as (engine, _):
        apart = [engine.add(a_box(), a_state((5.0 * i, 0.0, 0.1))) for i in range(3)]
        wall = engine.add(a_box(is_static=True), a_state((20.0, 0.0, 0.1)))
        advance(engine, 3)

        between = engine.add(a_box(), a_state((0.1, 0.0, 0.1)))
        at_the_wall = engine.add(a_box(), a_state((20.1, 0.0, 0.1)))

        assert list(engine.find_overlaps(between)) == [apart[0]]
        assert list(engine.find_overlaps(at_the_wall)) == [wall]
        assert list(engine.find_overlaps(wall)) == [at_the_wall]
        assert list(engine.find_overlaps(apart[2])) == []


class AskedEngine(ObedientEngine):
    """Records for which models it prepares, and which it expects."""

    def __init__(self, config: EngineConfig) -> None:
        super().__init__(config)
        self.prepared: list[Model] = []
        self.expected: list[Model] = []
        self.added: list[Model] = []

    def insert(self, body: int, model: Model, base: FloatArray) -> None:
        self.added.append(model)
        super().insert(body, model, base)

    def prepare(self, model: Model) -> bool:
        self.prepared.append(model)
        return True

    def expect(
        self,
        models: Sequence[Model],
        places: Sequence[Place] = (),  # noqa: ARG002
    ) -> None:
        self.expected = list(models)


@contextmanager
def asked(settings: CellSettings) -> Iterator[tuple[CelledEngine, list[AskedEngine]]]:
    made: list[AskedEngine] = []

    def make() -> Engine:
        made.append(AskedEngine(EngineConfig(STEP_NS)))
        return made[-1]

    engine = CelledEngine(EngineConfig(STEP_NS), InProcessCellExecutor(make), settings)
    try:
        yield engine, made
    finally:
        engine.close()


WALL = a_box("wall", is_static=True)


def test_full_cell_prepares_for_nothing_that_moves() -> None:
    with asked(CellSettings(single_cell_bodies=2, cell_bodies=2)) as (engine, cells):
        for at in range(3):
            engine.add(a_box(), on_ground(10.0 * at))

        engine.prepare(a_cart())
        engine.prepare(WALL)

        assert [cell.prepared for cell in cells] == [[WALL], [a_cart(), WALL]]


def test_models_of_a_small_world_are_expected_in_its_only_cell() -> None:
    with asked(CellSettings(single_cell_bodies=2)) as (engine, cells):
        engine.expect([a_box(), WALL, a_cart()])

        assert cells[0].expected == [a_box(), WALL, a_cart()]


def test_new_cell_expects_what_all_cells_have() -> None:
    with asked(CellSettings(single_cell_bodies=1, cell_bodies=1)) as (engine, cells):
        engine.expect([WALL, a_box(), a_box()])
        assert cells[0].expected == [WALL]

        engine.add(WALL, a_state((0.0, 5.0, 0.0)))
        for at in range(2):
            engine.add(a_box(), on_ground(10.0 * at))

        assert [cell.expected for cell in cells] == [[WALL], [WALL]]


def test_cell_expects_all_bodies_that_move_to_it_at_once() -> None:
    with asked(CellSettings(single_cell_bodies=1, cell_bodies=4)) as (engine, cells):
        for at in range(6):
            engine.add(a_box(f"box{at}"), on_ground(10.0 * at))
        assert len(cells) > 1

        for at in range(6):
            engine.set_base_state(at, on_ground(0.1 * at))
        engine.step()

        assert max(len(cell.expected) for cell in cells) > 1


def test_bodies_announced_with_their_places_get_the_cells_that_regrouping_would_choose() -> None:
    models = [a_box(f"b{at}") for at in range(6)]
    places = [(10.0 * at, 0.0) for at in range(6)]
    settings = CellSettings(single_cell_bodies=2, cell_bodies=4, moved_bodies=1)
    with asked(settings) as (engine, cells):
        engine.expect([WALL, *models], [(0.0, 5.0), *places])
        expected = [cell.expected for cell in cells]

        engine.add(WALL, a_state((0.0, 5.0, 0.0)))
        for model, (x, _) in zip(models, places, strict=True):
            engine.add(model, on_ground(x))
        engine.step()

        assert expected == [[WALL, *models[:3]], [WALL, *models[3:]]]
        assert [cell.added for cell in cells] == expected


def test_body_that_is_not_where_it_was_announced_gets_a_cell_nevertheless() -> None:
    models = [a_box(f"b{at}") for at in range(3)]
    with asked(CellSettings(single_cell_bodies=1, cell_bodies=2)) as (engine, _):
        engine.expect(models, [(10.0 * at, 0.0) for at in range(3)])

        bodies = [engine.add(model, on_ground(7.0 * at)) for at, model in enumerate(models)]
        bodies.append(engine.add(a_cart(), on_ground(50.0)))
        engine.step()

        assert engine.read(bodies).base[:, 0] == pytest.approx([0.0, 7.0, 14.0, 50.0], abs=1e-3)


def test_announced_places_of_models_that_cannot_be_measured_change_nothing() -> None:
    broken = Model("m", (Link("m", collisions=(Shape("mesh", mesh="gone"),)),))
    with asked(CellSettings(single_cell_bodies=1, cell_bodies=1)) as (engine, cells):
        engine.expect([broken, a_box(), WALL], [(0.0, 0.0), (10.0, 0.0), (0.0, 5.0)])

        engine.add(a_box(), on_ground(10.0))

        assert [cell.expected for cell in cells] == [[WALL]]
