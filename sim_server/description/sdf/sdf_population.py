"""<population> elements of a world, replaced by their models at the poses of a distribution.

Source: gazebo-classic's Population: regions, distributions and names. Random positions come from a
generator that is seeded by the name of the population, so that a file gives the same world always.
"""

from __future__ import annotations

import math
from copy import deepcopy
from dataclasses import dataclass
from typing import TYPE_CHECKING
from zlib import crc32

import numpy as np

from zensim.proto.rigid_transforms import rotate
from zensim.sim_server.description.element_rules import check_element
from zensim.sim_server.description.sdf.sdf_rules import POPULATION
from zensim.sim_server.description.sdf.sdf_values import (
    read_pose,
    read_scalar,
    read_text,
    read_vector,
)
from zensim.sim_server.description.strict_parsing import quote
from zensim.sim_server.errors import ModelError

if TYPE_CHECKING:
    from collections.abc import Callable

    import numpy.typing as npt
    from lxml.etree import _Element as Element

    from zensim.sim_server.description.report import ParseReport

    Points = npt.NDArray[np.float64]

MAX_POPULATION = 2000
"""Models of one population."""
UNIT_BOX = (1.0, 1.0, 1.0)
GRID_STEP_M = (0.5, 0.5, 0.0)
"""Default of SDF for the step of a grid."""
CYLINDER_SAMPLES = 10_000
"""Points of which a uniform distribution takes the centroids."""
SAMPLE_SPACING_M = 0.1
MAX_SAMPLES = 20_000
CLUSTERING_ROUNDS = 20


@dataclass(frozen=True)
class PopulationRegion:
    """A box or a cylinder; lengths [m], positions from its corner or from its lower centre."""

    size: tuple[float, float, float] = UNIT_BOX
    radius: float = 0.0
    length: float = 0.0

    @property
    def is_cylinder(self) -> bool:
        """Whether it is a cylinder."""
        return self.radius > 0.0

    def sample(self, count: int, random: np.random.Generator) -> Points:
        """Choose positions at random, as Gazebo does; shape (count, 3)."""
        if not self.is_cylinder:
            return random.uniform((0.0, 0.0, 0.0), self.size, (count, 3))
        angle, radius = random.uniform(0, math.tau, count), random.uniform(0, self.radius, count)
        height = random.uniform(0.0, self.length, count)
        return np.column_stack((radius * np.cos(angle), radius * np.sin(angle), height))


def expand_populations(world: Element, report: ParseReport) -> None:
    """Replace the populations of a world by models, in place.

    Raises:
        ModelError: A number is invalid, or there are too many models.
    """
    for population in world.findall("population"):
        name = (population.get("name") or "").strip()
        where = f"population {quote(name)}"
        check_element(population, POPULATION, where, report)
        model = population.find("model")
        included = population.find("include")
        template = model if model is not None else included
        if template is None:
            report.suspicious(where, "has no <model>; left out")
            world.remove(population)
            continue
        positions = _find_positions(population, name, where)
        for number, position in enumerate(positions.tolist()):
            world.insert(world.index(population), _place_model(template, number, position))
        world.remove(population)
        report.applied(where, f"{len(positions)} models")


def _place_model(template: Element, number: int, position: list[float]) -> Element:
    model = deepcopy(template)
    for old in model.findall("pose"):
        model.remove(old)
    pose = model.makeelement("pose", {})
    pose.text = " ".join(f"{value:.9g}" for value in position) + " 0 0 0"
    model.append(pose)
    if model.tag == "model":
        model.set("name", f"{model.get('name') or ''}_clone_{number}")
        return model
    named = model.find("name")
    if named is None:
        named = model.makeelement("name", {})
        named.text = read_text(model, "uri").rstrip("/").rpartition("/")[2]
        model.append(named)
    named.text = f"{(named.text or '').strip()}_clone_{number}"
    return model


def _find_positions(population: Element, name: str, where: str) -> Points:
    """Find the positions of the models [m], in the world."""
    distribution = population.find("distribution")
    kind = read_text(distribution, "type", "random") if distribution is not None else "random"
    pose = read_pose(population, where).origin
    if kind == "grid" and distribution is not None:
        offsets, corner = _make_grid(distribution, where)
    else:
        region, corner = _read_region(population, where)
        count = _read_count(population, "model_count", where)
        random = np.random.default_rng(crc32(name.encode()))
        offsets = _choose_distribution(kind, region, where)(count, region, random)
    turned: Points = np.array([rotate(pose.orientation, (x, y, z)) for x, y, z in offsets.tolist()])
    moved: Points = turned.reshape(-1, 3) + np.array(pose.position) + corner
    return moved


def _choose_distribution(
    kind: str, region: PopulationRegion, where: str
) -> Callable[[int, PopulationRegion, np.random.Generator], Points]:
    known = DISTRIBUTIONS if not region.is_cylinder else CYLINDER_DISTRIBUTIONS
    if kind not in known:
        raise ModelError(
            f"{where}: distribution {quote(kind)} is not known for its region; "
            f"use one of {', '.join(known)}",
            slug="sdf.population",
        )
    return known[kind]


def _read_region(population: Element, where: str) -> tuple[PopulationRegion, Points]:
    cylinder, box = population.find("cylinder"), population.find("box")
    if cylinder is not None:
        radius, length = (read_scalar(cylinder, tag, 1.0, where) for tag in ("radius", "length"))
        region = PopulationRegion(radius=radius, length=length)
        is_valid, corner = min(radius, length) > 0.0, np.zeros(3)
    else:
        size = read_vector(box, "size", UNIT_BOX, where) if box is not None else UNIT_BOX
        region, corner = PopulationRegion(size), -np.array(size) / 2.0
        is_valid = min(size) > 0.0
    if not is_valid:
        raise ModelError(f"{where}: its region is empty; use sizes > 0", slug="sdf.population")
    return region, corner


def _read_count(owner: Element, tag: str, where: str) -> int:
    count = read_scalar(owner, tag, 1.0, where)
    if not 1 <= count <= MAX_POPULATION:
        raise ModelError(
            f"{where}, {tag}: {count:g}; use 1 to {MAX_POPULATION}", slug="sdf.population"
        )
    return int(count)


def _make_grid(distribution: Element, where: str) -> tuple[Points, Points]:
    rows, columns = (_read_count(distribution, tag, where) for tag in ("rows", "cols"))
    if rows * columns > MAX_POPULATION:
        raise ModelError(
            f"{where}: {rows} x {columns} models; use at most {MAX_POPULATION}",
            slug="sdf.population",
        )
    step = np.array(read_vector(distribution, "step", GRID_STEP_M, where))
    places = [(column, row, 0.0) for row in range(rows) for column in range(columns)]
    corner = -np.array((columns - 1.0, rows - 1.0, 0.0)) * step / 2.0
    return np.array(places) * step * (1.0, 1.0, 0.0), corner


def _place_randomly(count: int, region: PopulationRegion, random: np.random.Generator) -> Points:
    return region.sample(count, random)


def _place_uniformly(count: int, region: PopulationRegion, random: np.random.Generator) -> Points:
    """Place models at the centroids (k-means) of points that fill the region."""
    if region.is_cylinder:
        points = region.sample(CYLINDER_SAMPLES, random)
    else:
        spacing = max(SAMPLE_SPACING_M, math.sqrt(region.size[0] * region.size[1] / MAX_SAMPLES))
        x, y = np.meshgrid(*(np.arange(0.0, side, spacing) for side in region.size[:2]))
        heights = random.uniform(0.0, region.size[2], x.size)
        points = np.column_stack((x.ravel(), y.ravel(), heights))
    return _find_cluster_centres(points, count, random)


def _find_cluster_centres(points: Points, count: int, random: np.random.Generator) -> Points:
    """Find centroids with Lloyd's algorithm (k-means); shape (count, 3)."""
    # A region smaller than the spacing has fewer points than models.
    centres = points[random.choice(len(points), count, replace=len(points) < count)]
    for _ in range(CLUSTERING_ROUNDS):
        labels = _find_nearest(points, centres)
        sizes = np.bincount(labels, minlength=count)
        sums = np.column_stack(
            [np.bincount(labels, points[:, axis], minlength=count) for axis in range(3)]
        )
        centres = np.where(sizes[:, None] > 0, sums / np.maximum(sizes, 1)[:, None], centres)
    return centres


def _find_nearest(points: Points, centres: Points) -> npt.NDArray[np.intp]:
    # |p - c|^2 = |p|^2 - 2 p c + |c|^2, in blocks that bound the memory.
    squares = (centres**2).sum(axis=1)
    block = max(1, 2_000_000 // len(centres))
    return np.concatenate(
        [
            np.argmin(squares - 2.0 * points[start : start + block] @ centres.T, axis=1)
            for start in range(0, len(points), block)
        ]
    )


def _place_along(axis: int) -> Callable[[int, PopulationRegion, np.random.Generator], Points]:
    def place(count: int, region: PopulationRegion, _: np.random.Generator) -> Points:
        points = np.tile(np.array(region.size) / 2.0, (count, 1))
        points[:, axis] = region.size[axis] * np.arange(count) / count
        return points

    return place


CYLINDER_DISTRIBUTIONS = {"random": _place_randomly, "uniform": _place_uniformly}
DISTRIBUTIONS = CYLINDER_DISTRIBUTIONS | {
    "linear-x": _place_along(0),
    "linear-y": _place_along(1),
    "linear-z": _place_along(2),
}
