"""box_bot_legacy: mistakes of old tutorials are reported, and it drives as in Gazebo."""

import numpy as np
import pytest

from tests.engines import PHYSICAL, STEP_NS, MakeEngine, advance
from tests.models import a_state
from tests.sim_server.description.robots import mentions
from zensim.proto.messages.model_messages import Model
from zensim.sim_server.description.builtin_models import read_builtin_model
from zensim.sim_server.description.model_geometry import find_ground_clearance
from zensim.sim_server.description.urdf.urdf_parser import read_urdf
from zensim.sim_server.physics.engine_config import EngineConfig

SPAWN_Z = 0.01
"""Wheels start five centimetres under ground."""
WRITTEN_RADIUS, TRACK = 0.0125, 0.1
MISTAKES = (
    ("plugin", "names swapped"),
    ("wheel_diameter", "0.025 m", "'joint_right_wheel'", "0.07 m"),
    ("'wheel_left_joint'",),
    ("'wheel_right_joint'",),
    ("inertia: ", "more than once"),
    ("'front_caster': <kp>", "1e27"),
    ("'back_caster': <kd>", "1e27"),
)


@pytest.fixture(scope="module")
def legacy() -> Model:
    return read_urdf(read_builtin_model("box_bot_legacy"))


@pytest.mark.parametrize("mistake", MISTAKES)
def test_report_names_each_mistake(legacy: Model, mistake: tuple[str, ...]) -> None:
    assert mentions(legacy.report, "suspicious", *mistake)


def test_report_names_links_without_mass(legacy: Model) -> None:
    links = "links 'base_link', 'camera_link', 'camera_frame'"

    assert mentions(legacy.report, "applied", links, "<inertial>")


def test_legacy_robot_has_the_given_masses_and_6_cm_clearance(legacy: Model) -> None:
    assert legacy.mass_kg == pytest.approx(1.406, abs=1e-6)
    assert legacy.links[0].inertial.mass_kg == pytest.approx(1.006, abs=1e-6)
    assert find_ground_clearance(legacy) == pytest.approx(-0.06, abs=1e-6)


@pytest.mark.parametrize("make", PHYSICAL, ids=lambda make: make.name)
@pytest.mark.parametrize(("speed", "turn"), [(0.2, 0.0), (0.0, 1.0), (0.1, 0.5)])
def test_legacy_robot_drives_2_8_times_as_fast_as_commanded(
    legacy: Model, make: MakeEngine, speed: float, turn: float
) -> None:
    engine = make(EngineConfig(STEP_NS))
    body = engine.add(legacy, a_state((0.0, 0.0, SPAWN_Z)))
    advance(engine, 240)

    rims = np.array([speed - turn * TRACK / 2.0, speed + turn * TRACK / 2.0])
    engine.command([body], rims / WRITTEN_RADIUS)
    advance(engine, 480)

    row = engine.read([body]).base[0]
    engine.close()
    assert np.hypot(row[7], row[8]) == pytest.approx(2.8 * speed, abs=0.005)
    assert row[12] == pytest.approx(2.8 * turn, abs=0.03)
