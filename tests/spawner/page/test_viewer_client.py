"""Where the camera of a visitor goes."""

import numpy as np
import pytest

from zensim.proto.messages.agent_messages import STATE_COLUMNS
from zensim.proto.messages.telemetry_messages import EntityModel
from zensim.spawner.page.model_bounds import ModelBounds
from zensim.spawner.page.model_visuals import VisualTemplate
from zensim.spawner.page.render_state import RenderedFleet, RenderedFrame
from zensim.spawner.page.viewer_client import (
    FOLLOW_DISTANCE_M,
    CameraFollow,
    CameraMode,
    PageState,
    place_camera,
)

FOCUS = np.array((5.0, 1.0, 0.2))
TEMPLATE = VisualTemplate((), ())


def follow(mode: CameraMode, offset: tuple[float, float, float], **given: float) -> np.ndarray:
    """Follow a point until the camera rests; return its offset."""
    numbers = {"yaw_rad": 0.0, "least_m": 0.0, "reach_m": FOLLOW_DISTANCE_M} | given
    position, target = np.array(offset), np.zeros(3)
    for _ in range(100):
        position = place_camera(CameraFollow(mode, **numbers), position, target, FOCUS)
        target = FOCUS
    return np.asarray(position - FOCUS)


@pytest.mark.parametrize(
    ("distance_m", "least_m", "reach_m", "kept_m"),
    [(9.0, 0.0, 1.6, 1.6), (0.5, 0.0, 1.6, 0.5), (0.5, 4.0, 5.0, 4.0), (4.5, 4.0, 5.0, 4.5)],
)
def test_orbiting_camera_comes_near_and_moves_back_only_as_asked(
    distance_m: float, least_m: float, reach_m: float, kept_m: float
) -> None:
    offset = follow("Orbit", (distance_m, 0.0, 0.0), least_m=least_m, reach_m=reach_m)

    assert offset == pytest.approx((kept_m, 0.0, 0.0), abs=1e-6)


@pytest.mark.parametrize("mode", ["Chase", "Top"])
def test_offset_of_a_camera_grows_with_the_entity(mode: CameraMode) -> None:
    near = follow(mode, (1.0, 1.0, 1.0))
    far = follow(mode, (1.0, 1.0, 1.0), reach_m=3.0 * FOLLOW_DISTANCE_M)

    assert far == pytest.approx(3.0 * near, abs=1e-6)


def a_state(bounds: list[tuple[float, float, float]]) -> PageState:
    base = np.zeros((1, STATE_COLUMNS))
    base[0, :7] = (1.0, 2.0, 0.5, 0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5))
    fleet = RenderedFleet(
        names=("mast",),
        members={"mast": EntityModel("mast", "mast", 0)},
        rows={"mast": 0},
        templates={"mast": TEMPLATE},
    )
    return PageState(
        fleet, RenderedFrame(base=base), find_bounds=lambda _: ModelBounds(np.array(bounds))
    )


def test_camera_looks_at_the_middle_of_an_entity_and_has_it_in_view() -> None:
    state = a_state([(0.0, -1.0, 0.0), (2.0, 1.0, 8.0)])

    assert state.find_middle("mast") == pytest.approx((1.0, 3.0, 4.5))
    assert state.find_follow_distance("mast") > np.linalg.norm((2.0, 2.0, 8.0))
    assert a_state([(0.0, 0.0, 0.0), (0.1, 0.1, 0.1)]).find_follow_distance("mast") == (
        FOLLOW_DISTANCE_M
    )
