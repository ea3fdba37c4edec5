#!/bin/sh
# A planner in a shell: straight on with a little throttle, whatever is there. It answers each line with a line.
#
#     sage simulate examples/crossing.pkl --ego 'cmd:sh examples/planners/straight_on.sh' --out drives/
while read -r message; do
  case "$message" in
    '{"hello"'*) echo '{"hello": 1}' ;;
    '{"reset"'*) echo '{"ready": true}' ;;
    *) echo '{"steer": 0.0, "throttle": 0.1}' ;;
  esac
done
