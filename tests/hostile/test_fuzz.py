"""Random robots, and randomly damaged real ones, are parsed or refused."""

import math
import random

from hypothesis import given, settings
from hypothesis import strategies as st

from tests.hostile.corpus import corpus
from zensim.proto.messages.model_messages import Model
from zensim.sim_server.description.builtin_models import read_builtin_model
from zensim.sim_server.description.joint_reduction import MAX_JOINTS
from zensim.sim_server.description.urdf.urdf_parser import read_urdf
from zensim.sim_server.errors import ModelError

SEEDS = [
    read_builtin_model("box_bot"),
    *(case.text for case in corpus() if case.slug != "xml.encoding" and len(case.text) < 20_000),
]
WORDS = (
    *("nan", "-1", "0", "1e308", "1e-320", "", " ", "a", "world", "0 0 0", "1 1 1 1", "${x}"),
    *("<", ">", "/>", "</", '"', "&", "<![CDATA[", "-->", "<?", "\ufeff", "\u202e"),
    *("revolute", "planar", "floating", "fixed", "<mimic joint='j'/>", "<gazebo>", "<plugin/>"),
)
TAGS = (
    *("link", "joint", "inertial", "mass", "inertia", "collision", "visual", "geometry", "box"),
    *("sphere", "mesh", "origin", "axis", "limit", "mimic", "parent", "child", "gazebo", "plugin"),
    *("sensor", "ros", "material", "color", "mu1", "transmission"),
)
ATTRIBUTES = (
    *("name", "type", "link", "joint", "value", "xyz", "rpy", "radius", "length", "size", "scale"),
    *("filename", "reference", "ixx", "iyy", "izz", "lower", "upper", "rgba", "multiplier"),
)
VALUES = st.sampled_from(
    ("a", "b", "j", "1", "-1", "0 0 1", "1 1 1", "nan", "fixed", "continuous", "planar", "", "imu")
)


def read_or_refusal(text: str) -> Model | ModelError:
    try:
        return read_urdf(text)
    except ModelError as refusal:
        return refusal


def assert_read_or_refused(text: str) -> None:
    found = read_or_refusal(text)
    if isinstance(found, ModelError):
        assert found.message.startswith(f"{found.slug}: ")
        assert found.message.isprintable()
        return
    assert len(found.joints) == len(found.links) - 1 <= MAX_JOINTS
    numbers = [
        number
        for link in found.links
        for number in (link.inertial.mass_kg, *link.inertial.com_in_link, *link.inertial.inertia)
    ]
    assert all(map(math.isfinite, numbers))


def damaged(text: str, chance: random.Random) -> str:
    """Cut, repeat, swap or replace pieces of a text."""
    for _ in range(chance.randint(1, 4)):
        start = chance.randint(0, len(text))
        end = min(len(text), start + chance.choice((0, 1, 3, 20, 200)))
        other = chance.randint(0, len(text))
        piece = chance.choice(
            ("", text[start:end] * 2, text[other : other + end - start], chance.choice(WORDS))
        )
        text = text[:start] + piece + text[end:]
    return text


@given(seed=st.sampled_from(SEEDS), chance=st.randoms(use_true_random=False))
@settings(max_examples=settings().max_examples * 5)
def test_damaged_description_is_parsed_or_refused(seed: str, chance: random.Random) -> None:
    assert_read_or_refused(damaged(seed, chance))


def elements(children: st.SearchStrategy[str]) -> st.SearchStrategy[str]:
    attributes = st.dictionaries(st.sampled_from(ATTRIBUTES), VALUES, max_size=4)
    return st.builds(
        lambda tag, given, inside: (
            f"<{tag} {' '.join(f'{k}={v!r}' for k, v in given.items())}>{''.join(inside)}</{tag}>"
        ),
        st.sampled_from(TAGS),
        attributes,
        st.lists(children, max_size=4),
    )


@given(inside=st.lists(st.recursive(st.just(""), elements, max_leaves=15), max_size=6))
@settings(max_examples=settings().max_examples * 5)
def test_random_tags_are_parsed_or_refused(inside: list[str]) -> None:
    assert_read_or_refused(f"<robot name='r'>{''.join(inside)}</robot>")
