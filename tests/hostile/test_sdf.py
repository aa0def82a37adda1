"""Hostile SDF robots are refused with their slugs; damaged ones are parsed or refused."""

import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.hostile.case import Case
from tests.hostile.sdf import INERTIAL, joint, link, model, sdf_cases
from tests.hostile.test_fuzz import damaged
from tests.sim_server.description.sdf_robots import PIONEER
from zensim.sim_server.description.pipeline import read_robot
from zensim.sim_server.errors import ModelError

CASES = tuple(sdf_cases())
NESTED = f'<model name="n">{link("c")}{link("d")}{joint("k", "c", "d")}</model>'
SEEDS = (
    PIONEER,
    model(link("a"), link("b"), joint("j", "a", "b"), NESTED),
    model(link("a", f'<pose relative_to="f">0 0 1 0 0 0</pose>{INERTIAL}'), '<frame name="f"/>'),
    *(case.text for case in CASES if len(case.text) < 20_000 and case.slug != "xml.encoding"),
)


def refusal_of(text: str) -> ModelError | None:
    try:
        read_robot(text)
    except ModelError as refusal:
        return refusal
    return None


@pytest.mark.parametrize("case", CASES, ids=lambda case: ascii(case.name))
def test_sdf_robot_is_refused_with_its_slug(case: Case) -> None:
    refusal = refusal_of(case.text)

    assert (refusal.slug if refusal else "") == case.slug


@given(seed=st.sampled_from(SEEDS), chance=st.randoms(use_true_random=False))
@settings(max_examples=settings().max_examples * 5)
def test_damaged_sdf_robot_is_parsed_or_refused(seed: str, chance: random.Random) -> None:
    refusal = refusal_of(damaged(seed, chance))

    assert refusal is None or refusal.message.startswith(f"{refusal.slug}: ")
