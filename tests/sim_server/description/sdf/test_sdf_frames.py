"""Poses of SDF frames against products of matrices."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from zensim.proto.messages.model_messages import Origin
from zensim.proto.rigid_transforms import compose, invert, transform_point
from zensim.proto.se3 import FloatArray, from_rpy, to_matrix
from zensim.sim_server.description.parsed_model import MODEL_FRAME
from zensim.sim_server.description.sdf.sdf_frames import PoseGraph
from zensim.sim_server.description.sdf.sdf_values import RelativePose
from zensim.sim_server.errors import ModelError

NUMBERS = st.floats(-3.0, 3.0, allow_nan=False)
ORIGINS = st.builds(
    lambda place, turn: Origin(place, tuple(from_rpy(*turn).tolist())),
    st.tuples(NUMBERS, NUMBERS, NUMBERS),
    st.tuples(NUMBERS, NUMBERS, NUMBERS),
)


def matrix(origin: Origin) -> FloatArray:
    whole = np.eye(4)
    whole[:3, :3], whole[:3, 3] = to_matrix(np.array(origin.orientation)), origin.position
    return whole


def at(x: float = 0.0, frame: str = "") -> RelativePose:
    return RelativePose(Origin((x, 0.0, 0.0)), frame)


@given(st.lists(ORIGINS, min_size=1, max_size=6), st.data())
def test_pose_is_the_product_of_matrices_when_frames_are_nested(
    origins: list[Origin], data: st.DataObject
) -> None:
    frames, expected = PoseGraph(), {MODEL_FRAME: np.eye(4)}
    for number, origin in enumerate(origins):
        parent = data.draw(st.sampled_from(sorted(expected)))
        frames.add(f"f{number}", RelativePose(origin, parent), scope="", implied=MODEL_FRAME)
        expected[f"f{number}"] = expected[parent] @ matrix(origin)

    found = {name: matrix(frames.pose(name)) for name in sorted(expected, reverse=True)}

    for name, whole in expected.items():
        np.testing.assert_allclose(found[name], whole, atol=1e-9)


@given(ORIGINS)
def test_inverse_of_a_pose_is_the_identity_when_composed(origin: Origin) -> None:
    np.testing.assert_allclose(matrix(compose(invert(origin), origin)), np.eye(4), atol=1e-9)


@given(ORIGINS, ORIGINS)
def test_pose_of_an_include_is_that_of_its_placement_frame(pose: Origin, inner: Origin) -> None:
    frames = PoseGraph()
    frames.add("arm", RelativePose(pose), scope="", implied=MODEL_FRAME)
    frames.add("hand", RelativePose(inner), scope="arm", implied=MODEL_FRAME)
    frames.set_placement_frame("arm", "arm::hand")

    np.testing.assert_allclose(matrix(frames.pose("arm::hand")), matrix(pose), atol=1e-9)


def test_names_are_resolved_in_their_model() -> None:
    frames = PoseGraph()
    frames.add("arm", at(1.0), scope="", implied=MODEL_FRAME)
    frames.add("hand", at(5.0), scope="", implied=MODEL_FRAME)
    frames.add("hand", at(2.0), scope="arm", implied=MODEL_FRAME)
    frames.add("tip", at(4.0, "hand"), scope="arm", implied=MODEL_FRAME)

    assert transform_point(frames.pose("arm::tip"), (0.0, 0.0, 0.0)) == (7.0, 0.0, 0.0)


def test_first_frame_is_used_when_two_have_one_name() -> None:
    frames = PoseGraph()
    frames.add("a", at(1.0), scope="", implied=MODEL_FRAME)
    frames.add("a", at(2.0), scope="", implied=MODEL_FRAME)

    assert frames.pose("a").position == (1.0, 0.0, 0.0)


def test_poses_in_a_cycle_are_refused() -> None:
    frames = PoseGraph()
    for name, parent in (("a", "b"), ("b", "c"), ("c", "a")):
        frames.add(name, at(frame=parent), scope="", implied=MODEL_FRAME)

    with pytest.raises(ModelError) as caught:
        frames.pose("a")

    assert caught.value.slug == "sdf.pose_cycle"


def test_placement_frame_placed_outside_its_model_is_refused() -> None:
    frames = PoseGraph()
    frames.add("arm", at(), scope="", implied=MODEL_FRAME)
    frames.set_placement_frame("arm", "nothing")

    with pytest.raises(ModelError) as caught:
        frames.pose("arm")

    assert caught.value.slug == "sdf.unknown_frame"


def test_chain_of_a_thousand_frames_is_resolved() -> None:
    frames = PoseGraph()
    for number in range(1000):
        parent = f"f{number + 1}" if number < 999 else MODEL_FRAME
        frames.add(f"f{number}", at(1.0, parent), scope="", implied=MODEL_FRAME)

    assert frames.pose("f0").position == (1000.0, 0.0, 0.0)
