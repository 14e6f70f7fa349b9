"""The reference drivers of UN Regulation No. 157 as drivers of a scenario."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from cornercase._common.errors import InputError, suggest_name
from cornercase._common.typing import FloatArray
from cornercase.drivers._base import Situation
from cornercase.drivers._varied_driver import VariedDriver
from cornercase.drivers.references.r157._models import REFERENCES, BrakingReaction
from cornercase.drivers.references.r157._relative_motion_tracker import RelativeMotionTracker

# m/s² towards the scenario's target speed while nothing is unsafe.
_TARGET_SPEED_ACCELERATION, _TARGET_SPEED_DECELERATION = 2.0, 4.0


class ReferenceDriver(VariedDriver):
    """Reference driver of UN Regulation No. 157, defined for cut-ins, cut-outs and decelerations.

    The driver drives at the scenario's target speed until another vehicle becomes unsafe. From then on, the driver
    brakes or keeps its speed, and does not accelerate again. The driver does not steer, and does not predict crossing
    paths; see ``docs/drivers.md``.

    Parameters
    ----------
    name : {"cc-human", "fsm", "rss", "reg157"}
        Reference driver: careful and competent human, fuzzy safety model, Responsibility-Sensitive Safety, or driver
        with the reaction time of paragraph 5.2.5.2 of the regulation.
    delay : float, optional
        Time in s from the first unsafe instant to braking; by default the delay in the regulation.

    Raises
    ------
    InputError
        If there is no such reference driver, or the delay is below 0 or not finite.

    References
    ----------
    UN Regulation No. 157, 5.2.5.2 and Annex 4, Appendix 3; Annex 3, Appendix 3 of the 01 series of amendments.
    Mattas et al., Driver models for the definition of safety requirements of automated vehicles in international
    regulations. Application to motorway driving conditions, Accident Analysis & Prevention 174 (2022) 106743.

    Examples
    --------
    >>> import cornercase as cc
    >>> from cornercase.drivers import ReferenceDriver
    >>> human = ReferenceDriver("cc-human")
    >>> cc.simulate("examples/r157/cut_in.xosc", drivers={"Ego": human})
    <Recording of Ego (car), Other (car), 3.4 s in 69 instants, Ego and Other collide at 3.4 s>
    """

    def __init__(self, name: str, delay: float | None = None) -> None:
        if name not in REFERENCES:
            raise InputError(f"There is no reference driver '{name}'; {suggest_name(name, sorted(REFERENCES))}")
        reference = REFERENCES[name]
        if delay is not None:
            if not (np.isfinite(delay) and delay >= 0.0):
                raise InputError(
                    f"`delay` of the driver '{name}' is {delay}; it has to be a number of seconds, 0 or more."
                )
            reference = replace(reference, delay=float(delay))
        self._reference, self._text = reference, name if delay is None else f"{name}:delay={delay}"
        self.settings = {"driver": name, "delay": reference.delay}
        self.start(0, 0)

    def __str__(self) -> str:
        return self._text

    def start(self, scenarios: int, others: int) -> None:
        """Reset all state for a batch with the given numbers of scenarios, and of other entities in each scenario."""
        self._reaction = BrakingReaction(self._reference, scenarios)
        self._surroundings = RelativeMotionTracker(scenarios, others)
        self._acceleration = np.zeros(scenarios)

    def vary(self, options: Sequence[Mapping[str, float]]) -> None:
        """Set the delay of the started driver in each scenario."""
        self._reaction.delay[:] = [changed["delay"] for changed in options]

    def acceleration(self, situation: Situation) -> FloatArray:
        """Return the acceleration along the path in m/s², shape (N,); 0 in scenarios that are not active."""
        s, dt = situation, situation.time_step
        assessment = self._reference.assess(self._surroundings.track_relative_motion(s, self._acceleration))
        is_unsafe = assessment.unsafe & s.active[:, None]
        deceleration = np.where(is_unsafe, assessment.deceleration, 0.0).max(axis=1, initial=0.0)
        unsafe = is_unsafe.any(axis=1)
        reaction = self._reaction.acceleration(unsafe, deceleration, dt)
        # Without a target speed, keep the current one.
        target = np.where(np.isfinite(s.target_speed), s.target_speed, s.speed)
        max_acceleration = np.where(self._reaction.reacted, 0.0, _TARGET_SPEED_ACCELERATION)
        free = np.clip((target - s.speed) / dt, -_TARGET_SPEED_DECELERATION, max_acceleration)
        a = np.maximum(np.where(unsafe, reaction, free), -s.speed / dt)
        self._acceleration[s.active] = a[s.active]
        return np.where(s.active, a, 0.0)
