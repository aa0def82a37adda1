"""Trained policies: files, actions, and baselines that do as well as docs/learning.md says."""

import re
import runpy
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.contract.repository import ROOT
from zensim.api.api_errors import Invalid
from zensim.envs.trained_policy import Policy, load_baseline

ROW = re.compile(r"^\| `(\w+)` \| [0-9]+ \| (?:([0-9]+) %|-) \| ([0-9]+) % \|", re.MULTILINE)
"""Task, robots that succeed, and worlds where none fails."""
drive = runpy.run_path(str(ROOT / "examples" / "learning" / "evaluate.py"))["drive"]
STATED = {
    task: (float(succeeded or 0) / 100.0, float(without) / 100.0)
    for task, succeeded, without in ROW.findall((ROOT / "docs/learning.md").read_text("utf-8"))
}
WORLDS = 128
MARGIN = 0.08
"""Worlds are others than those of the page: three deviations of shares from 0.8 on."""


def make_policy(observed: int = 3, hidden: int = 5) -> Policy:
    random = np.random.default_rng(7)
    sizes = [(observed, hidden), (hidden, hidden), (hidden, 2)]
    layers = [
        (random.normal(size=size).astype(np.float32), np.zeros(size[1], np.float32))
        for size in sizes
    ]
    scale = np.full(observed, 0.5, np.float32), np.full(observed, 2.0, np.float32)
    return Policy("reach", {"count": 4}, scale=scale, layers=layers)


def test_file_has_the_policy_that_was_saved(tmp_path: Path) -> None:
    policy, rows = make_policy(), np.random.default_rng(1).normal(size=(4, 2, 3))
    policy.save(tmp_path / "p.npz")

    found = Policy.load(tmp_path / "p.npz")

    assert (found.task, found.settings) == ("reach", {"count": 4})
    assert found.act(rows).shape == (4, 2, 2)
    np.testing.assert_array_equal(found.act(rows), policy.act(rows))


def test_actions_are_within_their_range() -> None:
    actions = make_policy().act(1e6 * np.random.default_rng(1).normal(size=(99, 3)))

    assert np.abs(actions).max() <= 1.0


def write(**changes: Any) -> BytesIO:  # noqa: ANN401
    """Write the arrays of a policy, with changes; None leaves one out."""
    stream, plain = BytesIO(), BytesIO()
    make_policy().save(plain)
    plain.seek(0)
    arrays = {**np.load(plain), **changes}
    np.savez(stream, **{name: one for name, one in arrays.items() if one is not None})
    stream.seek(0)
    return stream


@pytest.mark.parametrize(
    "changes",
    [
        {"facts": None},
        {"facts": np.array("{}")},
        {"facts": np.array("no JSON")},
        {"facts": np.array('["list"]')},
        {"facts": np.array({"task": "reach"}, dtype=object)},
        {"mean": np.zeros(4, np.float32)},
        {"deviation": np.zeros((3, 3), np.float32)},
        {"bias1": np.full(5, np.nan, np.float32)},
        {"bias2": None},
        {"weights0": np.zeros((4, 5), np.float32)},
        {"weights2": np.zeros((5, 3), np.float32), "bias2": np.zeros(3, np.float32)},
        {"weights1": np.array(["text"])},
    ],
)
def test_file_that_is_no_policy_is_refused(changes: dict[str, Any]) -> None:
    with pytest.raises(Invalid):
        Policy.load(write(**changes))


@pytest.mark.parametrize("payload", [b"", b"PK", b"text", b"\x80\x04."])
def test_file_that_is_no_archive_is_refused(payload: bytes) -> None:
    with pytest.raises(Invalid):
        Policy.load(BytesIO(payload))


@pytest.mark.parametrize("shape", [(10, 16), (4,), ()])
def test_observations_of_another_task_are_refused(shape: tuple[int, ...]) -> None:
    with pytest.raises(Invalid) as refusal:
        make_policy(observed=3).act(np.zeros(shape))

    assert refusal.value.slug == "wrong_shape"


def test_unknown_baseline_is_refused_with_those_that_are_known() -> None:
    with pytest.raises(Invalid, match="avoid"):
        load_baseline("fly")


def test_the_page_states_figures_of_each_baseline() -> None:
    folder = ROOT / "zensim" / "envs" / "baselines"

    assert {file.stem for file in folder.iterdir()} == STATED.keys()
    assert len(STATED) == 5


@pytest.mark.parametrize("task", STATED)
def test_baseline_does_in_new_worlds_what_its_page_says(task: str) -> None:
    succeeded, without = STATED[task]

    found = drive(load_baseline(task), WORLDS, seed=2_000_000)

    assert found.succeeded.mean() >= succeeded - MARGIN
    assert (~found.failed.any(axis=1)).mean() >= without - MARGIN
