"""What a planner in the ego's seat sees.

A planner has `act(obs)`, and may have `reset(scene, seed)`, which is called before each drive. `act` returns

- two numbers: steer and throttle, both in [-1, 1], steer positive to the left;
- a plan: an array (n, 2), (n, 3) or (n, 4) of x, y, heading and speed in the car's frame (x ahead, y to the left), the first row
  0.1 s ahead and one every 0.1 s (`obs.to_car(x, y)` takes a point of the scene there); or
- a dictionary of the protocol, such as `{"acceleration": 1.0, "steering_angle": 0.02}` or `{"plan": rows, "again": 5}`.

The same class drives over the door for programs of any language (`sage simulate --ego 'cmd:python3 my_planner.py'`), with
`advsage.sage_planner.serve`. Units: metres, seconds, radians; positions in the frame of the scene.
"""

from __future__ import annotations

from functools import cached_property
from typing import Any, Protocol

import numpy as np

from . import sage_planner
from .sage_planner import Agent, Car, Ego, from_gym, from_metadrive

__all__ = ["Agent", "Car", "Ego", "Observation", "Planner", "Route", "Scene", "from_gym", "from_metadrive"]


class Planner(Protocol):
    """What drives: an object with `act(obs)`; `reset(scene, seed)` and `act_many(observations)` are optional."""

    def act(self, obs: Observation, /) -> Any:
        """What the car is to do in the next step."""


class Scene(sage_planner.Scene):
    """What is known before a drive: `id`, `route`, `car`, `lights` (on the route: dictionaries with `lane`, `along` and `point`),
    `other_lights`, `map` (a list of dictionaries), `route_lanes` (ids), and as arrays `lanes`, `edges` and `route.array`."""

    def __init__(self, told, drive=0):
        self._told = told
        #: Number of the drive among those that `act_many` is asked about.
        self.drive = drive
        self.id = told.id
        self.route = Route(told.route())
        self.car = Car(told.car())
        self.lights = told.lights()
        self.other_lights = told.other_lights()
        #: Where the recording ends along the route, metres, for a planner with `wants_goal = True`.
        self.goal = told.goal
        #: How to follow plans, for a planner that offers ways: `follows = ("plan", "exact")`.
        self.follow = told.follow

    def __repr__(self):
        return f"<Scene '{self.id}': route of {self.route.length:.0f} m, {len(self.lights)} lights>"

    @cached_property
    def map(self):
        """Features of the map within 50 m of the route: dictionaries as in the message `reset` of the protocol."""
        return self._told.map()

    @cached_property
    def route_lanes(self):
        """Ids of the lanes that the route follows, in their order."""
        return self._told.route_lanes()

    @cached_property
    def lanes(self):
        """Centre lines of all lanes of the scene: a list of arrays (points, 3), read-only."""
        return self._told.lines(False)

    @cached_property
    def edges(self):
        """Edges of the road: a list of arrays (points, 3), read-only."""
        return self._told.lines(True)


class Route(sage_planner.Route):
    """The path to follow, a polyline: `points`, `length`, `locate(x, y)`, `point(along, across)`, `heading(along)`."""

    @cached_property
    def array(self):
        """Its points: array (points, 2)."""
        return np.array(self.points)


class _Ego(Ego):
    def __init__(self, numbers):
        self.x, self.y, self.heading, self.vx, self.vy, self.yaw_rate = numbers[:6]
        self.acceleration, self.steering_angle = numbers[6:]


class _Agent(Agent):
    __slots__ = ()

    def __init__(self, row):
        self.id, self.type, self.length, self.width, self.x, self.y, self.heading, self.vx, self.vy = row


class Observation(sage_planner.Observation):
    """What the driver sees before a step of 0.1 s. Every field is made when it is first read."""

    def __init__(self, step, scene):
        self._step = step
        self.scene = scene
        #: Time since the start of the drive.
        self.t = step.t

    def __repr__(self):
        return f"<Observation at {self.t:.1f} s: {self.ego!r}, {len(self.agents)} agents>"

    @cached_property
    def ego(self):
        """The driven car: `x`, `y`, `heading`, `vx`, `vy`, `yaw_rate`, `acceleration`, `steering_angle`, `speed`."""
        return _Ego(self._step.ego())

    @cached_property
    def ego_row(self):
        """The driven car as a row of `agent_rows`: array (7,) of x, y, heading, vx, vy, length, width."""
        x, y, heading, vx, vy = self._step.ego()[:5]
        return np.array([x, y, heading, vx, vy, self.scene.car.length, self.scene.car.width])

    @cached_property
    def agents(self):
        """The other road users, the nearest first, at most 64."""
        return [_Agent(row) for row in self._step.agents()]

    @cached_property
    def agent_ids(self):
        """Track ids of the other road users, the nearest first."""
        return self._step.agent_ids()

    @cached_property
    def agent_rows(self):
        """The other road users, the nearest first: array (agents, 7) of x, y, heading, vx, vy, length, width (metres, radians, m/s)."""
        return self._step.agent_rows()

    @cached_property
    def _history(self):
        return self._step.agent_history()

    @property
    def agent_history(self):
        """The rows of the other road users over ten frames, the present one last: array (64, 10, 7). They are in the present order; rows
        behind the last road user, and frames in which one was not seen, are 0 and not in `agent_mask`."""
        return self._history[0]

    @property
    def agent_mask(self):
        """Where `agent_history` is known: array (64, 10) of bool."""
        return self._history[1]

    @cached_property
    def lights(self):
        """States of `scene.lights` now: "red", "yellow", "green", "flashing red" or "unknown"."""
        return self._step.lights()

    @cached_property
    def other_lights(self):
        """States of `scene.other_lights` now."""
        return self._step.other_lights()

    @cached_property
    def history(self):
        """The messages of the last ten frames as the protocol has them, the oldest first, this one last."""
        return self._step.messages()

    @property
    def fields(self):
        """The message of this step as the protocol has it."""
        return self.history[-1]

    @cached_property
    def _vector(self):
        return self._step.vector()

    def vector(self):
        """The 101 numbers of a learning driver, as MetaDrive's policies are trained on: array (101,) of 32-bit floats."""
        return self._vector
