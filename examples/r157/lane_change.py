"""Two systems under test for the motorway: one changes lanes to pass, the other steers around what stands ahead."""

from __future__ import annotations

import math

import numpy as np

import cornercase as cc
from cornercase.drivers import Ego, View


class PassSlowLeader(cc.SystemUnderTest):
    """Keeps its speed; changes to the left lane to pass a slower car, and brakes while that does not help.

    Parameters
    ----------
    time_gap : float
        Time in s until it would reach the car ahead from which on it passes that car.
    deceleration : float
        In m/s², while the car ahead is nearer than `braking_distance` m and slower.
    braking_distance : float
        In m.
    """

    def __init__(self, time_gap: float = 5.0, deceleration: float = 6.0, braking_distance: float = 8.0) -> None:
        self.time_gap, self.deceleration, self.braking_distance = time_gap, deceleration, braking_distance

    def step(self, view: View, dt: float) -> cc.Control:
        """Ask for the left lane, or brake."""
        leader = view.leader
        if leader is None or leader.closing <= 0.0:
            return cc.Control(acceleration=0.0)
        if leader.gap < self.braking_distance:
            return cc.Control(acceleration=-self.deceleration)
        if leader.gap < self.time_gap * leader.closing:
            return cc.Control(acceleration=0.0, lane_change="left")
        return cc.Control(acceleration=0.0)


class Evade(cc.SystemUnderTest):
    """Keeps its speed, and steers into the lane on one side when it would soon hit something.

    The steering is a period of a sine in time, which shifts the car by a lane and turns it back.

    Parameters
    ----------
    time_to_collision : float
        Time in s before a collision at which it begins to steer.
    shift : float
        Distance in m by which it steers aside; positive to the left.
    duration : float
        Time in s that this takes.
    """

    def __init__(self, time_to_collision: float = 2.5, shift: float = 3.5, duration: float = 2.2) -> None:
        self.time_to_collision, self.shift, self.duration = time_to_collision, shift, duration

    def start(self, ego: Ego, road: object, rng: np.random.Generator) -> None:
        """Remember the vehicle."""
        self.wheelbase, self.begun = ego.wheelbase, math.inf

    def step(self, view: View, dt: float) -> cc.Control:
        """Steer aside once; then follow the lane in which the ego is."""
        leader, ego = view.leader, view.ego
        is_close = leader is not None and leader.gap < self.time_to_collision * leader.closing
        if is_close and math.isinf(self.begun):
            self.begun = view.time
        passed = (view.time - self.begun) / self.duration
        if not 0.0 <= passed < 1.0:
            return cc.Control(acceleration=0.0)
        peak = 2.0 * math.pi * self.shift / self.duration**2
        lateral = peak * math.sin(2.0 * math.pi * (passed + 0.5 * dt / self.duration))
        return cc.Control(acceleration=0.0, steering=math.atan(self.wheelbase * lateral / ego.speed**2))
