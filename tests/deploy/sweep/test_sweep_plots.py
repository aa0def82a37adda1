"""Pictures of margins."""

from pathlib import Path

import pytest

from tests.deploy.sweep.sweep_samples import make_sweep_row
from zensim.deploy.sweep.sweep_plots import draw_margins

ROWS = [
    make_sweep_row(
        f"{number}",
        inputs={"v": number % 3, "w": "x", "same": 1.0},
        margins={"apart": 0.1 * number, "slow": None},
        failed=("apart",) if number == 2 else (),
        number=number,
    )
    for number in range(6)
]


@pytest.mark.parametrize("suffix", [".png", ".svg", ".pdf"])
def test_picture_has_a_panel_for_each_check_and_varied_number(suffix: str, tmp_path: Path) -> None:
    file = tmp_path / f"margins{suffix}"

    panels = draw_margins(ROWS, file, title="short")

    assert panels == 2
    assert file.stat().st_size > 1000


def test_margins_are_drawn_over_seeds_where_no_number_varies(tmp_path: Path) -> None:
    rows = [make_sweep_row(f"{one}", number=one, margins={"apart": 0.1}) for one in range(3)]

    assert draw_margins(rows, tmp_path / "a.svg", title="short") == 1
    assert "number of the seed" in (tmp_path / "a.svg").read_text()
