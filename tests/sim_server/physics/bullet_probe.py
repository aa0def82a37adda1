"""Bullet's own values of an engine's bodies."""

from dataclasses import dataclass

import pybullet

from zensim.sim_server.physics.bullet.pybullet_engine import PyBulletEngine


@dataclass(frozen=True)
class Dynamics:
    """Dynamics of one part of a body in Bullet."""

    mass_kg: float
    friction: float
    inertia: tuple[float, float, float]
    com: tuple[float, float, float]
    principal: tuple[float, float, float, float]
    restitution: float
    rolling_friction: float
    spinning_friction: float


def client_of(engine: PyBulletEngine) -> int:
    return engine._client  # noqa: SLF001  reads Bullet directly


def unique_id_of(engine: PyBulletEngine, body: int) -> int:
    """Find the number that Bullet gave to a body."""
    return engine._unique_ids[body]  # noqa: SLF001  reads the map of the engine


def link_numbers(engine: PyBulletEngine, body: int) -> tuple[int, ...]:
    """List Bullet's number of each link; the root is -1."""
    return engine._bodies[unique_id_of(engine, body)].links  # noqa: SLF001  reads the map of the engine


def dynamics_of(engine: PyBulletEngine, body: int) -> list[Dynamics]:
    """List the parts of a body, root first."""
    body, client = unique_id_of(engine, body), client_of(engine)
    count = pybullet.getNumJoints(body, physicsClientId=client)
    return [
        Dynamics(*pybullet.getDynamicsInfo(body, link, physicsClientId=client)[:8])
        for link in range(-1, count)
    ]


def next_shape(engine: PyBulletEngine) -> int:
    """Find the number of the next collision shape; it grows when shapes leak."""
    client = client_of(engine)
    shape = pybullet.createCollisionShape(pybullet.GEOM_SPHERE, radius=1.0, physicsClientId=client)
    pybullet.removeCollisionShape(shape, physicsClientId=client)
    return shape


def bodies_in(engine: PyBulletEngine) -> int:
    return pybullet.getNumBodies(physicsClientId=client_of(engine))


def touching(engine: PyBulletEngine, first: int, second: int) -> int:
    """Count the contact points of two bodies."""
    pair = unique_id_of(engine, first), unique_id_of(engine, second)
    return len(pybullet.getContactPoints(*pair, physicsClientId=client_of(engine)))
