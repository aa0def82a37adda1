"""Settings of time: lengths of steps, and how fast they follow each other."""

from typing import Annotated, Final, TypedDict

import msgspec

from zensim.proto.settings.setting import Setting

CONTROL_HZ: Final = 100.0
"""Default maximum rate of drive states, as the default update rate of Gazebo's drives."""
MAX_STEP_HZ: Final = 10_000.0
MAX_REAL_TIME_FACTOR: Final = 1000.0
STEP_RATE_TOLERANCE: Final = 1e-6
"""Relative: a step is a whole number of ns."""


class PaceSettings(msgspec.Struct, frozen=True, kw_only=True):
    """Rates of a world."""

    rtf: Annotated[
        float | None,
        Setting(
            help="Target real-time factor; 0 = as fast as possible.",
            panel="Physics",
            metavar="FACTOR",
            unit="1",
            least=0.0,
            most=MAX_REAL_TIME_FACTOR,
            usual="from the world file, or 1",
            key="time.speed",
        ),
    ] = None
    step_hz: Annotated[
        float | None,
        Setting(
            help="Physics rate.",
            panel="Physics",
            metavar="HZ",
            unit="Hz",
            clock="simulation time",
            least=1.0,
            most=MAX_STEP_HZ,
            usual="from the world file, or 240; with `dynamics` kinematic, `control_hz`",
            key="engine.step_rate",
        ),
    ] = None
    control_hz: Annotated[
        float,
        Setting(
            help="Maximum rate of state messages to agents.",
            panel="Physics",
            metavar="HZ",
            unit="Hz",
            clock="simulation time",
            least=1.0,
            most=MAX_STEP_HZ,
            key="engine.control_rate",
        ),
    ] = CONTROL_HZ

    def choose_step_rate(self, usual_hz: float) -> float:
        """Choose the step rate [Hz]: what is set, or else the usual one."""
        return self.step_hz or usual_hz

    def complete(self, *, usual_hz: float, usual_factor: float) -> "PaceSettings":
        """Complete the step rate [Hz] and the real-time factor where they are not set."""
        return msgspec.structs.replace(
            self,
            step_hz=self.choose_step_rate(usual_hz),
            rtf=usual_factor if self.rtf is None else self.rtf,
        )

    def require_step_rate(self, hz: float) -> None:
        """Check that the step rate, if it is set, is that of a world that goes on [Hz].

        Raises:
            ValueError: It is another one.
        """
        asked = self.choose_step_rate(hz)
        if abs(asked - hz) > STEP_RATE_TOLERANCE * hz:
            raise ValueError(f"counts steps of {hz:g} Hz, not {asked:g}; leave `step_hz` out")


class PaceKeywords(TypedDict, total=False):
    """Rates of a world, as keyword arguments."""

    step_hz: float | None
    """Steps per simulated second; None = of the world file, or 240."""
    control_hz: float | None
    """Most control steps per simulated second; None = 100."""


def list_equal_rates(hz: float) -> PaceKeywords:
    """List the keywords of a world that makes a control step in each step, at this rate [Hz]."""
    return PaceKeywords(step_hz=hz, control_hz=hz)
