"""Rates of odometry and tf that an agent is told, in place of those of the description."""

from collections.abc import Sequence

import msgspec

from zensim.proto.messages.agent_messages import Claim
from zensim.proto.messages.model_messages import Model


class Rates(msgspec.Struct, frozen=True):
    """How often [simulated Hz]; 0 = at every drive state, None = as described."""

    odom_hz: float | None = None
    tf_hz: float | None = None
    """None = as described, or else with odometry."""


def with_rates(claims: Sequence[Claim], rates: Rates) -> tuple[Claim, ...]:
    """Put rates into the models of claims; those that share a model go on sharing it."""
    if rates == Rates():
        return tuple(claims)
    models = {id(claim.model): _with_rates(claim.model, rates) for claim in claims}
    return tuple(msgspec.structs.replace(claim, model=models[id(claim.model)]) for claim in claims)


def _with_rates(model: Model, rates: Rates) -> Model:
    if (drive := model.drive) is None:
        return model
    odom_hz = drive.odometry_rate_hz if rates.odom_hz is None else rates.odom_hz
    tf_hz = drive.tf_rate_hz if rates.tf_hz is None else rates.tf_hz
    paced = msgspec.structs.replace(drive, odometry_rate_hz=odom_hz, tf_rate_hz=tf_hz)
    return msgspec.structs.replace(model, drive=paced)
