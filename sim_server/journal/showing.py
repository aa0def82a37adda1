"""A journal for people and for other programs."""

from __future__ import annotations

from typing import TYPE_CHECKING

import msgspec

from zensim.proto.messages.simulation_messages import State
from zensim.proto.messages.standard_messages import NANOSECONDS

if TYPE_CHECKING:
    from zensim.sim_server.journal.ledger import Ledger
    from zensim.sim_server.journal.restoring import Contents
    from zensim.sim_server.journal.rows import EntityRow


def summary(ledger: Ledger, contents: Contents | None) -> dict[str, object]:
    """Say what a journal holds, without descriptions."""
    if contents is None:
        return {"position": ledger.position, "entities": [], "aside": []}
    world, clock = contents.world, contents.clock
    return {
        "position": ledger.position,
        "lost": ledger.lost,
        "world": world.name,
        "world_model": world.source.name,
        "state": State(clock.state).name.lower(),
        "epoch": clock.epoch,
        "sim_time_s": round(contents.steps * round(NANOSECONDS / world.step_hz) * 1e-9, 9),
        "steps": contents.steps,
        "answers": len(contents.answers),
        "entities": [_entity(contents, row) for row in contents.entities],
        "aside": [{"name": row.entity.name, "reason": row.reason} for row in contents.aside],
    }


def exported(ledger: Ledger, contents: Contents | None) -> dict[str, object]:
    """Say everything, so that another server could be filled with it."""
    found = summary(ledger, contents)
    if contents is None:
        return found
    rows = (*contents.entities, *(row.entity for row in contents.aside))
    return {
        **found,
        "world_source": msgspec.to_builtins(contents.world.source),
        "step_hz": contents.world.step_hz,
        "seed": contents.world.seed,
        "descriptions": {row.name: contents.texts[row.text] for row in rows},
    }


def page(found: dict[str, object]) -> str:
    """Write a summary as lines."""
    head = [f"{word}: {value}" for word, value in found.items() if not isinstance(value, list)]
    entities, aside = found["entities"], found["aside"]
    assert isinstance(entities, list)
    assert isinstance(aside, list)
    lines = [_line(one) for one in entities]
    apart = [f"  {one['name']}: {one['reason']}" for one in aside]
    return "\n".join(
        [*head, f"entities: {len(entities)}", *lines, f"set aside: {len(aside)}", *apart]
    )


def _line(entity: dict[str, list[float]]) -> str:
    place = " ".join(f"{round(value, 3) + 0.0:.3f}" for value in entity["position"])
    return f"  {entity['name']}  ns={entity['namespace']}  model={entity['model']}  at {place}"


def _entity(contents: Contents, row: EntityRow) -> dict[str, object]:
    base, joints = contents.stand(row)
    model = contents.models[row.model]
    return {
        "name": row.name,
        "namespace": row.namespace,
        "model": model.name,
        "belongs_to_world": row.belongs_to_world,
        "bond": row.bond,
        "position": [round(value, 6) + 0.0 for value in base[:3].tolist()],
        "orientation": [round(value, 9) for value in base[3:7].tolist()],
        "joints": {
            joint.name: round(value, 6)
            for joint, value in zip(model.joints, joints.tolist(), strict=True)
        },
    }
