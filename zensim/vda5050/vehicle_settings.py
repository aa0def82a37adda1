"""Settings file of the vehicles: who they are, what they can do besides driving, their battery."""

from pathlib import Path
from typing import Annotated, Final, Literal, TypeAlias

import msgspec

from zensim.proto.bounded_files import read_text_file

Kind: TypeAlias = Literal["wait", "attach", "detach", "charge", "plug", "unplug", "trigger"]
Positive = Annotated[float, msgspec.Meta(gt=0.0, le=1000.0)]
Duration = Annotated[float, msgspec.Meta(ge=0.0, le=86_400.0)]
Percent = Annotated[float, msgspec.Meta(ge=0.0, le=100.0)]
Rate = Annotated[float, msgspec.Meta(ge=0.0, le=1e4)]
TopicLevel = Annotated[str, msgspec.Meta(pattern=r"^[A-Za-z0-9_.:-]{1,64}$")]


class BadSettings(ValueError):
    """The settings file has something else than settings."""


class ActionSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What an action of orders does."""

    kind: Kind = "wait"
    duration_s: Duration = 1.0
    """Simulation time; not used by `charge` and `trigger`."""
    until_percent: Percent = 100.0
    """Charge at which `charge` is finished."""


class BatterySettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """How the charge of a battery changes [percent]."""

    at_start: Percent = 100.0
    per_hour: Rate = 5.0
    per_km: Rate = 2.0
    charged_per_minute: Rate = 5.0
    low: Percent = 20.0


DEFAULT_ACTIONS: Final = {
    "pick": ActionSettings("attach", 3.0),
    "drop": ActionSettings("detach", 3.0),
    "wait": ActionSettings("wait", 1.0),
    "charge": ActionSettings("charge"),
    "startCharging": ActionSettings("plug", 0.0),
    "stopCharging": ActionSettings("unplug", 0.0),
    "waitForTrigger": ActionSettings("trigger"),
}


class FleetSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Settings of all vehicles."""

    manufacturer: TopicLevel = "zensim"
    map_id: Annotated[str, msgspec.Meta(max_length=256)] = ""
    """Empty = the name of the world."""
    max_speed: Positive = 1.0
    """[m/s]."""
    max_turn: Positive = 1.0
    """[rad/s]."""
    acceleration: Positive = 0.5
    """[m/s^2], also before stops."""
    start_tolerance_m: Positive = 0.5
    """Distance from the first node, where an order names none."""
    max_deviation_m: Positive = 1.0
    """Distance from the route at which a vehicle stops with an error."""
    visualization_hz: Annotated[float, msgspec.Meta(ge=0.0, le=30.0)] = 1.0
    """0 = none."""
    actions: dict[str, ActionSettings] = {}
    """Further actions by actionType; those of the same name replace the default ones."""
    battery: BatterySettings = BatterySettings()

    @property
    def all_actions(self) -> dict[str, ActionSettings]:
        """The actions of orders by actionType."""
        return DEFAULT_ACTIONS | self.actions


def read_settings(path: Path) -> FleetSettings:
    """Read a settings file in JSON.

    Raises:
        OSError: The file cannot be read.
        BadSettings: It is no JSON, or has something else.
    """
    try:
        return msgspec.json.decode(read_text_file(path), type=FleetSettings)
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
        raise BadSettings(
            f"{path}: {str(error)[:300]}; docs/vda5050.md lists the settings"
        ) from None
