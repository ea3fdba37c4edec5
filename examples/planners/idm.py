"""The Intelligent Driver Model along the route: `sage`'s own `idm` without lane changes, curves and speed limits.

    sage simulate examples/crossing.pkl --ego 'cmd:python3 examples/planners/idm.py' --out drives/
"""

import math

from sage_planner import serve

DESIRED_SPEED, TIME_GAP, STANDING_GAP = 40.0 / 3.6, 1.5, 2.0
ACCELERATION, DECELERATION, EXPONENT = 1.0, 3.0, 4.0
LIMITS = (-3.0, 1.0)


def model(speed, leader):
    """Acceleration at a speed behind a leader (gap and speed), or without one."""
    free = 1.0 - (speed / DESIRED_SPEED) ** EXPONENT
    if leader is None:
        return ACCELERATION * free
    gap, other = leader
    braking = speed * (speed - other) / (2.0 * math.sqrt(ACCELERATION * DECELERATION))
    wish = STANDING_GAP + max(speed * TIME_GAP + braking, 0.0)
    return ACCELERATION * (free - (wish / max(gap, 0.01)) ** 2)


class RedLights:
    """Stops at red lights on the route that the car can stop at, and keeps to that until they change."""

    def __init__(self, scene):
        self.places = [light["along"] for light in scene.lights]
        self.stops = [False] * len(self.places)

    def gap(self, obs, speed):
        """Distance from the front bumper to the next stop, or None."""
        if not self.places:
            return None
        ego, car, route = obs.ego, obs.scene.car, obs.scene.route
        half = 0.5 * car.length
        front, _ = route.locate(ego.x + half * math.cos(ego.heading), ego.y + half * math.sin(ego.heading))
        # It brakes by at most its speed through 0.2 s.
        slow = min(speed, -LIMITS[0] * 0.2)
        distance = (speed * speed - slow * slow) / (-2.0 * LIMITS[0]) + slow * 0.2
        nearest = None
        for k, place in enumerate(self.places):
            gap = place - front
            can_stop = gap > 0.0 and (speed <= 0.5 or distance <= gap)
            self.stops[k] = obs.lights[k] == "red" and (can_stop or (self.stops[k] and gap > -1.0))
            if self.stops[k] and nearest is None:
                nearest = max(gap, 0.0)
        return nearest


class Idm:
    def reset(self, scene, seed):
        self.lights = RedLights(scene)

    def act(self, obs):
        route, car = obs.scene.route, obs.scene.car
        speed = max(obs.ego.speed, 0.0)
        # Two paths count: beside the route as the car is, and on it.
        own = model(speed, obs.leader(route))
        middle = model(speed, obs.leader(route, across=0.0))
        red = self.lights.gap(obs, speed)
        stop = math.inf if red is None else model(speed, (red, 0.0))
        acceleration = min(max(min(own, middle, stop), LIMITS[0]), LIMITS[1])
        ahead = min(1.5 + 0.25 * math.hypot(obs.ego.vx, obs.ego.vy), 15.0)
        return obs.steer_to(route, ahead), car.throttle_for(acceleration)


serve(Idm())
