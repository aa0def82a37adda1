"""Populations of a world become models."""

import itertools
import math

import numpy as np
import pytest

from tests.sim_server.description.sdf_robots import a_link
from zensim.proto.messages.model_messages import Vec3
from zensim.sim_server.description.sdf.sdf_population import _find_cluster_centres
from zensim.sim_server.description.sdf.sdf_world import read_world
from zensim.sim_server.errors import ModelError

BOX = "<box><size>4 2 1</size></box>"
CYLINDER = "<cylinder><radius>2</radius><length>1</length></cylinder>"
GRID = "<type>grid</type><rows>2</rows><cols>3</cols><step>1 2 0</step>"


def a_population(region: str, kind: str, *, count: int = 4, pose: str = "10 0 0 0 0 0") -> str:
    return (
        f'<population name="p"><pose>{pose}</pose>{region}<model_count>{count}</model_count>'
        f"<distribution>{kind}</distribution>"
        f'<model name="can"><static>true</static>{a_link("l")}</model></population>'
    )


def places(population: str) -> dict[str, Vec3]:
    world = read_world(f'<sdf version="1.6"><world name="w">{population}</world></sdf>')
    return {placed.name: placed.origin.position for placed in world.models}


def test_grid_is_centred_on_its_pose() -> None:
    found = places(a_population("", GRID))

    assert list(found) == [f"can_clone_{number}" for number in range(6)]
    assert next(iter(found.values())) == (9.0, -1.0, 0.0)
    assert list(found.values())[-1] == (11.0, 1.0, 0.0)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_row_is_along_its_axis(axis: int) -> None:
    found = list(places(a_population(BOX, f"<type>linear-{'xyz'[axis]}</type>")).values())

    size = (4.0, 2.0, 1.0)[axis]
    steps = [after[axis] - before[axis] for before, after in itertools.pairwise(found)]
    assert steps == pytest.approx([size / 4.0] * 3)
    assert found[0][axis] == pytest.approx((10.0, 0.0, 0.0)[axis] - size / 2.0)


@pytest.mark.parametrize("kind", ["random", "uniform"])
@pytest.mark.parametrize("region", [BOX, CYLINDER])
def test_region_contains_all_models_each_time_at_the_same_places(region: str, kind: str) -> None:
    population = a_population(region, f"<type>{kind}</type>", count=20)

    found = places(population)

    assert found == places(population)
    assert len(set(found.values())) == 20
    for x, y, _ in found.values():
        assert math.hypot(x - 10.0, y) <= 2.0 if region == CYLINDER else abs(y) <= 1.0


@pytest.mark.parametrize(
    "population",
    [
        a_population(BOX, "<type>spiral</type>"),
        a_population(CYLINDER, "<type>linear-x</type>"),
        a_population(BOX, "<type>random</type>", count=0),
        a_population(BOX, "<type>random</type>", count=10_000_000),
        a_population(BOX.replace("4", "0"), "<type>random</type>"),
        a_population("", GRID.replace("<rows>2", "<rows>1999")),
    ],
)
def test_wrong_population_is_refused(population: str) -> None:
    with pytest.raises(ModelError) as caught:
        places(population)

    assert caught.value.slug == "sdf.population"


@pytest.mark.parametrize("seed", range(8))
def test_cluster_of_one_point_has_its_centre_there(seed: int) -> None:
    points = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [10.0, 0.0, 0.0]])

    centres = _find_cluster_centres(points, 2, np.random.default_rng(seed))

    assert sorted(centres[:, 0].tolist()) == [0.5, 10.0]
