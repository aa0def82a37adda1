"""How models of SDF files ask to move."""

import pytest

from zensim.sim_server.description.sdf import read_world
from zensim.sim_server.description.sdf_model import read_sdf_model

ROBOT = """<sdf version="1.7"><model name="m" xmlns:zensim="urn:zensim">
  {word}<link name="base"><inertial><mass>1</mass></inertial></link></model></sdf>"""
WORLD = """<sdf version="1.7"><world name="w" xmlns:zensim="urn:zensim"><model name="m">
  <zensim:dynamics>auto</zensim:dynamics>
  <link name="base"><inertial><mass>1</mass></inertial></link></model></world></sdf>"""


@pytest.mark.parametrize("word", ["full", "kinematic", "auto"])
def test_model_asks_for_its_dynamics(word: str) -> None:
    model = read_sdf_model(ROBOT.format(word=f"<zensim:dynamics> {word} </zensim:dynamics>"))

    assert model.dynamics == word
    assert not [entry for entry in model.report if "dynamics" in entry.subject + entry.reason]


def test_model_asks_for_none_unless_it_says_so() -> None:
    assert read_sdf_model(ROBOT.format(word="")).dynamics == ""


def test_word_that_is_none_is_noted() -> None:
    model = read_sdf_model(ROBOT.format(word="<zensim:dynamics>fast</zensim:dynamics>"))

    assert model.dynamics == ""
    assert [entry.reason for entry in model.report if entry.subject == "dynamics"] == [
        "'fast' is unknown; use full, kinematic, auto"
    ]


def test_model_of_a_world_asks_too() -> None:
    assert read_world(WORLD).models[0].model.dynamics == "auto"
