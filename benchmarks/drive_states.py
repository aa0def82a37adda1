"""Claims and drive states of box_bots, for agents without a server."""

from collections.abc import Iterator, Sequence

import numpy as np

from zensim.proto.messages.agent_messages import STATE_COLUMNS, Claim, DriveState
from zensim.robot_agent.agent_config import RateOverrides, override_rates
from zensim.sim_server.description.builtin_models import read_builtin_model
from zensim.sim_server.description.urdf.urdf_parser import read_urdf

PERIOD_NS = 10_000_000
MODEL = "box_bot"


def make_claims(robots: int) -> Sequence[Claim]:
    """Make claims of box_bots, whose odometry and tf are due at every state."""
    model = read_urdf(read_builtin_model(MODEL))
    claims = [
        Claim(number + 1, f"r{number}", f"r{number}", model, "<robot/>") for number in range(robots)
    ]
    return override_rates(claims, RateOverrides(0.0, 0.0))


def make_drive_states(robots: int) -> Iterator[DriveState]:
    """Generate states of these claims, one each 10 ms, with poses drawn once."""
    joints = robots * len(read_urdf(read_builtin_model(MODEL)).joints)
    draws = np.random.default_rng(1)
    base = draws.uniform(-1.0, 1.0, (robots, STATE_COLUMNS))
    base[:, 3:7] /= np.linalg.norm(base[:, 3:7], axis=1, keepdims=True)
    claims = np.arange(1, robots + 1, dtype="<u4").tobytes()
    positions = draws.uniform(-3.0, 3.0, joints).tobytes()
    step = 0
    while True:
        step += 1
        numbers = (base.tobytes(), positions, positions)
        yield DriveState(0, step, step * PERIOD_NS, claims, *numbers)
