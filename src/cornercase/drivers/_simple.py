"""Simple driver, which keeps its speed and its distance, and never yields."""

from __future__ import annotations

from cornercase.drivers._compiled import CompiledDriver
from cornercase.drivers._kernels.structs import SIMPLE
from cornercase.drivers._presets import FollowParameters, check_parameter


class SimpleDriver(CompiledDriver):
    """Driver that keeps the scenario's target speed, and brakes only for what is straight ahead in its lane.

    The driver is inattentive and looks neither left nor right, like the traffic that a test puts in the ego's path. It
    keeps its distance by the Intelligent Driver Model (Treiber, Hennecke and Helbing 2000).

    Parameters
    ----------
    acceleration, comfortable_deceleration, max_deceleration : float
        Highest acceleration, usual deceleration and highest deceleration in m/s².
    time_headway : float
        Time gap in s to the leader.
    min_gap : float
        Gap in m to the leader at rest.
    reaction_time : float
        Time in s for which something has to be ahead before the driver reacts.
    sight_range : float
        Distance in m up to which the driver looks ahead.

    Raises
    ------
    InputError
        If a parameter is out of range.

    Examples
    --------
    >>> import cornercase as cc
    >>> from cornercase.drivers import SimpleDriver
    >>> attentive = SimpleDriver(reaction_time=0.5, max_deceleration=8.0)
    >>> cc.simulate("examples/r157/deceleration.xosc", drivers={"Ego": attentive})
    <Recording of Ego (car), Other (car), 35.05 s in 702 instants, no collision>
    """

    name = "simple"
    kind = SIMPLE

    def __init__(
        self,
        *,
        acceleration: float = 3.0,
        comfortable_deceleration: float = 3.0,
        max_deceleration: float = 4.0,
        time_headway: float = 0.8,
        min_gap: float = 1.5,
        reaction_time: float = 2.5,
        sight_range: float = 60.0,
    ) -> None:
        values = (acceleration, comfortable_deceleration, max_deceleration, time_headway, min_gap, reaction_time)
        keeping = FollowParameters(*map(float, (*values, sight_range)))
        for name, value in keeping._asdict().items():
            check_parameter(name, value, name == "reaction_time")
        self.parameters = tuple(keeping)
        self.settings = {"driver": "simple", **keeping._asdict()}
        self.start(0, 0)
