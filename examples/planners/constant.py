"""The shortest planner: straight on with a little throttle, whatever is there.

    sage simulate examples/crossing.pkl --ego 'cmd:python3 examples/planners/constant.py' --out drives/
"""

from sage_planner import serve


class Constant:
    def act(self, obs):
        return 0.0, 0.1


serve(Constant())
