"""Empty slots lie where they do not mislead MuJoCo's search for contacts."""

import mujoco
import numpy as np

from tests.models import a_box_bot, box_bot_at
from tests.sim_server.physics.mujoco.test_mjcf import CONFIG, compile_slots, load_pieces
from zensim.sim_server.physics.blueprint import make_blueprint
from zensim.sim_server.physics.mujoco import mjcf
from zensim.sim_server.physics.mujoco.slot_layout import make_archetype
from zensim.sim_server.physics.mujoco.slot_state import (
    activate_slot,
    deactivate_all_slots,
    deactivate_slot,
)


def test_empty_slots_lie_at_the_origin() -> None:
    archetype = make_archetype(make_blueprint(a_box_bot()))
    slots = ((archetype, 3),)
    full, model = compile_slots(slots), compile_slots(slots)
    data, layout = mujoco.MjData(model), mjcf.make_model_layout(slots, CONFIG, load_pieces)
    used, emptied, _ = (layout.address(archetype, slot) for slot in range(3))

    deactivate_all_slots(model, data, layout)
    for address in (used, emptied):
        activate_slot(model, data, full, address)
        data.qpos[address.positions[:3]] = box_bot_at(50.0)[:3]
    deactivate_slot(model, data, emptied)

    mujoco.mj_kinematics(model, data)
    moved = np.abs(data.xipos[1:]).max(axis=1) > 1.0
    assert np.flatnonzero(moved).tolist() == (used.bodies - 1).tolist()
