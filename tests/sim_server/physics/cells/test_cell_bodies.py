"""Bodies have an order of cells."""

import numpy as np

from tests.models import a_box
from zensim.sim_server.physics.body_reach import BodyReach
from zensim.sim_server.physics.cells.cell_bodies import CellBodyTable, make_body_order


def test_order_has_the_cells_with_most_bodies_first_for_threads() -> None:
    table, reach = CellBodyTable(), BodyReach(0.1, 0.0, (), np.zeros(0))
    for body, cell in enumerate((2, 0, 1, 2, 1, 2, 3)):
        table.add(body, a_box(), reach, cell=cell)

    order = make_body_order(table)

    assert order.cells == (0, 1, 2, 3)
    assert order.largest_first == (2, 1, 0, 3)
