"""Places on the floor that a robot can reach: cells of the map away from what is fixed."""

import numpy as np

from zensim.api.api_errors import Invalid
from zensim.envs.robot_task import BoolArray, WorldStart
from zensim.proto.messages.standard_messages import OccupancyGrid
from zensim.proto.se3 import FloatArray

RESOLUTION_M = 0.1


def find_free_places(world: WorldStart, clearance_m: float) -> FloatArray:
    """Find the centres (k, 2) of cells that are connected with the place of the first robot.

    They lie between what is fixed, not outside of all of it.

    Args:
        world: With robots.
        clearance_m: Least distance from what is fixed, to the size of a cell.

    Raises:
        Invalid: Nothing is fixed in the world, or the robot is not in a free cell.
    """
    grid = world.draw_map(RESOLUTION_M)
    corner = np.array([grid.info.origin.position.x, grid.info.origin.position.y])
    start = np.floor((world.places[0] - corner) / RESOLUTION_M).astype(np.intp)
    is_free = _keep_clear(grid, round(clearance_m / RESOLUTION_M))
    height, width = is_free.shape
    is_in = 0 <= start[0] < width and 0 <= start[1] < height
    if not is_in or not is_free[start[1], start[0]]:
        raise Invalid(
            "the first robot does not stand on free floor of the map",
            hint="use a world with walls, such as `maze`, or another place",
        )
    found = _flood(is_free, (int(start[1]), int(start[0]))) & _find_between(grid)
    if not found.any():
        raise Invalid("no floor between what is fixed can be reached", hint="use another place")
    row, column = np.nonzero(found)
    return np.asarray(corner + (np.stack([column, row], axis=1) + 0.5) * RESOLUTION_M)


def _read_occupied(grid: OccupancyGrid) -> BoolArray:
    shape = grid.info.height, grid.info.width
    return np.asarray(np.frombuffer(grid.data, np.int8).reshape(shape) != 0)


def _find_between(grid: OccupancyGrid) -> BoolArray:
    """Find the cells (height, width) with occupied ones on both sides, along x and along y."""
    occupied = _read_occupied(grid)
    rows, columns = (_find_span(np.asarray(occupied.any(axis=axis))) for axis in (1, 0))
    return np.asarray(np.logical_and.outer(rows, columns))


def _find_span(is_line: BoolArray) -> BoolArray:
    after, before = (np.logical_or.accumulate(line) for line in (is_line, is_line[::-1]))
    return np.asarray(after & before[::-1])


def _keep_clear(grid: OccupancyGrid, cells: int) -> BoolArray:
    """Find the cells (height, width) at a distance from those that are occupied."""
    occupied = _read_occupied(grid)
    shape = occupied.shape
    wide = np.pad(occupied, cells)
    found = np.zeros(shape, np.bool_)
    for down in range(2 * cells + 1):
        for right in range(2 * cells + 1):
            if np.hypot(down - cells, right - cells) <= cells:
                found |= wide[down : down + shape[0], right : right + shape[1]]
    return np.asarray(~found)


def _flood(is_free: BoolArray, start: tuple[int, int]) -> BoolArray:
    """Find the free cells that are connected with a cell."""
    found = np.zeros_like(is_free)
    found[start] = True
    count = 0
    while (reached := int(found.sum())) > count:
        count = reached
        grown = found.copy()
        grown[1:] |= found[:-1]
        grown[:-1] |= found[1:]
        grown[:, 1:] |= found[:, :-1]
        grown[:, :-1] |= found[:, 1:]
        found = grown & is_free
    return found
