"""Ellipsoids and cones rest on the ground in each engine."""

from pathlib import Path

import pytest

from tests.engines import PHYSICAL, STEP_NS, MakeEngine, advance, running
from tests.models import a_state
from tests.sim_server.description.robots import a_collision, a_link, a_robot, an_inertial
from zensim.sim_server.description.pipeline import parse_description
from zensim.sim_server.physics.engine_config import EngineConfig


@pytest.mark.parametrize("make", PHYSICAL, ids=lambda make: make.name)
@pytest.mark.parametrize(
    ("solid", "height"),
    [('<ellipsoid radii="0.3 0.2 0.1"/>', 0.1), ('<cone radius="0.2" length="0.3"/>', 0.15)],
)
def test_solid_rests_at_half_its_height(
    make: MakeEngine, solid: str, height: float, tmp_path: Path
) -> None:
    text = a_robot(
        a_link("a", an_inertial("1", "0.01") + a_collision(f"<geometry>{solid}</geometry>"))
    )
    found = parse_description(text, assets={}, allow_missing=False, compat="fixed")
    for name, data in found.meshes.items():
        (tmp_path / f"{name}.stl").write_bytes(data)
    with running(make, EngineConfig(STEP_NS, mesh_folder=str(tmp_path))) as engine:
        body = engine.add(found.model, a_state((0.0, 0.0, height + 0.05)))

        advance(engine, round(2e9 / STEP_NS))

        base = engine.read([body]).base[0]
    assert base[2] == pytest.approx(height, abs=0.005)
