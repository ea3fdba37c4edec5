#!/bin/sh
# Compiles the solver of openpilot's longitudinal MPC into CHECKOUT/sage-mpc, once: sh build.sh CHECKOUT. It needs pip, gcc and make.
set -e
checkout=${1:?usage: sh build.sh CHECKOUT (a checkout of openpilot, such as commit 007bc41c)}
here=$(cd "$(dirname "$0")" && pwd)
packages="$checkout/sage-mpc/packages"
mkdir -p "$packages"
grep acados "$here/requirements.txt" | python3 -m pip install --quiet --no-deps --upgrade --target "$packages" -r /dev/stdin
rm -rf "$packages/casadi"
grep -v acados "$here/requirements.txt" | python3 -m pip install --quiet --upgrade --target "$packages" -r /dev/stdin
python3 "$here/mpc.py" "$checkout"
