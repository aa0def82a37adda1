"""`zensim map` writes files that a map server reads."""

from pathlib import Path

import numpy as np
import pytest
import yaml
from PIL import Image

from tests.deploy.cli.commands import assert_failed, run_at
from tests.integration.processes import Server
from zensim.deploy.cli.map_commands import app, make_map_yaml, make_pgm
from zensim.proto.exit_codes import ExitCode
from zensim.proto.messages.standard_messages import MapMetaData, OccupancyGrid, Point, Pose

CORNER = Pose(Point(-1.0, -2.5))
GRID = OccupancyGrid(
    info=MapMetaData(resolution=0.5, width=3, height=2, origin=CORNER),
    data=bytes([0, 100, 0, 255, 0, 0]),
)


def test_image_has_the_uppermost_row_first_in_grey_values_of_map_server(tmp_path: Path) -> None:
    (tmp_path / "map.pgm").write_bytes(make_pgm(GRID))

    with Image.open(tmp_path / "map.pgm") as image:
        pixels = np.asarray(image).tolist()

    assert pixels == [[205, 254, 254], [254, 0, 254]]


def test_yaml_names_image_resolution_and_corner() -> None:
    found = yaml.safe_load(make_map_yaml(GRID, "a map.pgm"))

    assert found == {
        "image": "a map.pgm",
        "mode": "trinary",
        "resolution": 0.5,
        "origin": [-1.0, -2.5, 0.0],
        "negate": 0,
        "occupied_thresh": 0.65,
        "free_thresh": 0.196,
    }


def test_map_of_a_server_is_written_beside_its_image(two: Server, tmp_path: Path) -> None:
    output = tmp_path / "hall.yaml"

    facts = run_at(two, app, "--output", str(output), "--resolution", "0.1", "--json").json()

    found = yaml.safe_load(output.read_text())
    assert (found["image"], found["resolution"]) == ("hall.pgm", 0.1)
    with Image.open(tmp_path / "hall.pgm") as image:
        assert image.size == (facts["width"], facts["height"])


@pytest.mark.parametrize("arguments", [("--resolution", "0"), ("--low", "2", "--high", "1")])
def test_map_that_is_refused_fails_with_one_line(
    two: Server, tmp_path: Path, arguments: tuple[str, ...]
) -> None:
    output = tmp_path / "map.yaml"

    done = run_at(two, app, "--output", str(output), *arguments)

    assert_failed(done, ExitCode.FAILED, "zensim map: ", "map.refused")
    assert not output.exists()
