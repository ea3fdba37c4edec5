"""openpilot's `long_mpc.py`, loaded from a checkout, with stand-ins for the modules of the car that it imports.

    python3 mpc.py CHECKOUT    generates and compiles its solver into CHECKOUT/sage-mpc (a part of build.sh)
"""

import ctypes
import importlib.util
import os
import sys
import types

PLACE = "selfdrive/controls/lib/longitudinal_mpc_lib/long_mpc.py"
STAND_INS = {
    "common.realtime": {"sec_since_boot": lambda: 0.0},
    "common.numpy_fast": {"clip": lambda x, low, high: max(low, min(high, x))},
    "selfdrive.swaglog": {"cloudlog": types.SimpleNamespace(warning=lambda text: print(text, file=sys.stderr))},
    "selfdrive.modeld.constants": {"index_function": lambda k, max_val, max_idx: max_val * (k / max_idx) ** 2},
    "selfdrive.controls.lib.radar_helpers": {"_LEAD_ACCEL_TAU": 1.5},
    "selfdrive.controls.lib.longitudinal_mpc_lib.c_generated_code.acados_ocp_solver_pyx": {"AcadosOcpSolverFast": None},
}


def folder_of(checkout):
    return os.path.join(os.path.abspath(checkout), "sage-mpc")


def acados_template(checkout):
    """The Python interface of acados from `CHECKOUT/sage-mpc/packages`."""
    sys.path.insert(0, os.path.join(folder_of(checkout), "packages"))
    import acados

    os.environ.update(ACADOS_SOURCE_DIR=acados.DIR, TERA_PATH=acados.TERA_PATH, ACADOS_PYTHON_INTERFACE_PATH=acados.TEMPLATE_DIR)
    for library in ("libqpOASES_e.so.3.1", "libblasfeo.so", "libhpipm.so", "libacados.so"):
        ctypes.CDLL(os.path.join(acados.LIB_DIR, library), mode=ctypes.RTLD_GLOBAL)
    from acados import acados_template

    return acados_template


def load(checkout, template):
    """The author's module, as it stands, with the compiled solver of `CHECKOUT/sage-mpc`."""
    path = os.path.join(checkout, PLACE)
    if not os.path.exists(path):
        sys.exit(f"{checkout} has no {PLACE}; expected a checkout of openpilot, such as commit 007bc41c")
    import numpy

    STAND_INS["common.numpy_fast"]["interp"] = numpy.interp
    for name, members in STAND_INS.items():
        parts = name.split(".")
        for k in range(len(parts)):
            package = ".".join(parts[: k + 1])
            sys.modules.setdefault(package, types.ModuleType(package))
        vars(sys.modules[name]).update(members)
    spec = importlib.util.spec_from_file_location("long_mpc", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    json = os.path.join(folder_of(checkout), "long.json")
    module.AcadosModel, module.AcadosOcp = template.AcadosModel, template.AcadosOcp
    module.AcadosOcpSolverFast = lambda name, steps: template.AcadosOcpSolver(None, json_file=json, generate=False, build=False)
    return module


if __name__ == "__main__":
    template, folder = acados_template(sys.argv[1]), folder_of(sys.argv[1])
    problem = load(sys.argv[1], template).gen_long_mpc_solver()
    problem.code_export_directory = folder
    template.AcadosOcpSolver.generate(problem, json_file=os.path.join(folder, "long.json"))
    template.AcadosOcpSolver.build(folder)
