"""Keeper: bodies once for all their users, files before the row that names them."""

from pathlib import Path

import msgspec
import numpy as np
import pytest

from tests.models import a_body
from zensim.proto.messages.model_messages import Link, Model, Shape
from zensim.sim_server.journal.keeping import Keeper
from zensim.sim_server.journal.ledger import FILES, Ledger, open_ledger
from zensim.sim_server.journal.records import Change, Kept, Record
from zensim.sim_server.journal.rows import EntityRow
from zensim.sim_server.world.entity import Entity

MESH = "ab" * 32


def a_meshed_model(mesh: str = MESH) -> Model:
    return Model("meshed", (Link("base", a_body(), (Shape("mesh", (1.0, 1.0, 1.0), mesh=mesh),)),))


def kept(name: str, model: Model, text: str = "<robot/>") -> Kept:
    return Kept(1, Entity(name, name, model, 0, np.zeros(13), text, born_ns=1))


def added(position: int, *those: Kept) -> Record:
    changes = tuple(Change(one.entity.name, None, one) for one in those)
    return Record(0, position, changes)


def removed(position: int, *those: Kept) -> Record:
    changes = tuple(Change(one.entity.name, one, None) for one in those)
    return Record(0, position, changes)


@pytest.fixture
def meshes(tmp_path: Path) -> Path:
    folder = tmp_path / "meshes"
    folder.mkdir()
    (folder / f"{MESH}.stl").write_bytes(b"solid")
    return folder


@pytest.fixture
def ledger(tmp_path: Path) -> Ledger:
    return open_ledger(tmp_path / "journal")


def test_keeper_copies_the_meshes_of_a_model(ledger: Ledger, meshes: Path) -> None:
    keeper = Keeper(ledger, str(meshes))

    keeper.keep([added(1, kept("a", a_meshed_model()))])

    assert (ledger.folder / FILES / f"{MESH}.stl").read_bytes() == b"solid"


def test_keeper_writes_no_row_whose_mesh_is_not_there(ledger: Ledger, meshes: Path) -> None:
    keeper = Keeper(ledger, str(meshes))

    with pytest.raises(OSError, match="No such file"):
        keeper.keep([added(1, kept("a", a_meshed_model("cd" * 32)))])

    assert (ledger.rows("entity"), ledger.position) == ({}, 0)


def test_keeper_shares_models_and_texts_and_drops_them_with_the_last(
    ledger: Ledger, meshes: Path
) -> None:
    keeper = Keeper(ledger, str(meshes))
    one, two = kept("a", a_meshed_model()), kept("b", a_meshed_model())
    keeper.keep([added(1, one, two)])
    assert (len(ledger.rows("model")), len(ledger.rows("text"))) == (1, 1)

    keeper.keep([removed(2, one)])
    assert len(ledger.rows("model")) == 1
    keeper.keep([removed(3, two)])

    assert (ledger.rows("model"), ledger.rows("text")) == ({}, {})


def test_keeper_that_failed_counts_as_before(ledger: Ledger, meshes: Path) -> None:
    keeper = Keeper(ledger, str(meshes))
    one = kept("a", a_meshed_model())
    keeper.keep([added(1, one)])
    with pytest.raises(OSError, match="No such file"):
        keeper.keep(
            [added(2, kept("b", a_meshed_model())), added(3, kept("c", a_meshed_model("x")))]
        )

    keeper.keep([removed(2, one)])

    assert ledger.rows("model") == {}


def test_keeper_sweeps_files_that_nobody_needs(ledger: Ledger, meshes: Path) -> None:
    keeper = Keeper(ledger, str(meshes))
    keeper.keep([added(1, kept("a", a_meshed_model()))])
    files = ledger.folder / FILES
    (files / f"{'ef' * 32}.stl").write_bytes(b"old")
    (files / "half.part").write_bytes(b"cut")

    keeper.sweep()

    assert [path.name for path in files.iterdir()] == [f"{MESH}.stl"]


def test_keeper_replaces_the_row_of_a_name(ledger: Ledger, meshes: Path) -> None:
    keeper = Keeper(ledger, str(meshes))
    keeper.keep([added(1, kept("a", a_meshed_model(), "<old/>"))])

    keeper.keep([added(2, kept("a", a_meshed_model(), "<new/>"))])

    (row,) = ledger.rows("entity").values()
    text = ledger.body("text", msgspec.msgpack.decode(row, type=EntityRow).text)
    assert text == b"<new/>"
    assert len(ledger.rows("text")) == 1
