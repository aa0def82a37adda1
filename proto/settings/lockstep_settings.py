"""Settings of waiting for agents and sensor processes at control steps."""

from typing import Annotated, Final, Literal

import msgspec

from zensim.proto.settings.setting import Setting

OnMiss = Literal["wait", "hold", "fail"]
LOCKSTEP_TIMEOUT_S: Final = 1.0


class LockstepSettings(msgspec.Struct, frozen=True, kw_only=True):
    """How long a server waits for its clients, and then."""

    lockstep: Annotated[
        bool,
        Setting(
            help="Wait for the command of every agent at each control step.",
            panel="Lockstep",
            key="time.mode",
            key_words=("free", "lockstep"),
            key_default="lockstep",
        ),
    ] = False
    lockstep_timeout: Annotated[
        float,
        Setting(
            help="Timeout of each agent's command; also for step requests.",
            panel="Lockstep",
            metavar="SECONDS",
            unit="s",
            least=0.01,
            most=3600.0,
            key="time.miss_timeout",
        ),
    ] = LOCKSTEP_TIMEOUT_S
    on_miss: Annotated[
        OnMiss,
        Setting(
            help="After that timeout: wait further, continue with the last targets (hold), "
            "or pause (fail).",
            panel="Lockstep",
            key="time.on_miss",
        ),
    ] = "hold"


PATIENT: Final = LockstepSettings(on_miss="wait")
"""Waits of a world whose results must be equal on a loaded machine, too."""
