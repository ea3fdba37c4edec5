#!/usr/bin/env python3
"""Writes mergekit.json: three small models, and what mergekit makes of them.

    pip install mergekit safetensors torch
    python make_mergekit_golden.py

The file in this folder was made with mergekit 0.1.5 and torch on a CPU. DARE drops values by torch's random
numbers, so it is compared at density 1 alone, where it drops none.
"""
import json
import subprocess
import sys
import tempfile
from pathlib import Path

import torch
from safetensors.torch import load_file, save_file

SHAPES = {"layer.weight": (4, 6), "layer.bias": (5,)}
# Name of our merger, its options, mergekit's method with its own parameters, weights of the two experts.
CASES = [
    ("linear", {}, "linear", {"normalize": True}, [0.3, 0.7]),
    ("ties", {"density": 1.0}, "ties", {"density": 1.0}, [0.5, 0.5]),
    ("ties", {"density": 0.5}, "ties", {"density": 0.5}, [0.3, 0.7]),
    ("ties", {"density": 0.2, "scale": 0.8}, "ties", {"density": 0.2, "lambda": 0.8}, [0.6, 0.4]),
    ("dare", {"density": 1.0}, "dare_linear", {"density": 1.0, "normalize": False}, [0.3, 0.7]),
    ("dare", {"density": 1.0, "consensus": "sum"}, "dare_ties", {"density": 1.0, "normalize": False}, [0.3, 0.7]),
    ("slerp", {"of": "weights"}, "slerp", {}, [0.35, 0.65]),
    ("model-stock", {}, "model_stock", {}, [0.5, 0.5]),
]


def model(seed, base=None):
    generator = torch.Generator().manual_seed(seed)
    noise = {name: torch.randn(shape, generator=generator) for name, shape in SHAPES.items()}
    if base is None:
        return noise
    # A common part keeps the angle between the experts below 90 degrees.
    common = torch.Generator().manual_seed(99)
    return {
        name: base[name] + 0.4 * noise[name] + 0.5 * torch.randn(shape, generator=common)
        for name, shape in SHAPES.items()
    }


def merged(folder, method, parameters, weights):
    own = {"density"} & parameters.keys()
    models = []
    for name, weight in zip(("realistic", "adversarial"), weights):
        entry = {"model": str(folder / f"{name}.safetensors")}
        given = {key: parameters[key] for key in own}
        if method not in ("slerp", "model_stock"):
            given["weight"] = weight
        models.append({**entry, "parameters": given} if given else entry)
    config = {"merge_method": method, "models": models, "dtype": "float32"}
    shared = {key: value for key, value in parameters.items() if key not in own}
    if method == "slerp":
        # mergekit's first model is the base; t is the share of the other one.
        config["base_model"] = models[0]["model"]
        shared["t"] = weights[1]
    elif method != "linear":
        config["base_model"] = str(folder / "prior.safetensors")
    if shared:
        config["parameters"] = shared
    recipe, out = folder / "recipe.yaml", folder / "out"
    recipe.write_text(json.dumps(config))
    subprocess.run([Path(sys.executable).parent / "mergekit-pytorch", recipe, out], check=True)
    return load_file(next(out.glob("*.safetensors")))


def numbers(tensors):
    return {name: tensor.flatten().tolist() for name, tensor in tensors.items()}


def main():
    prior = model(1)
    models = {"prior": prior, "realistic": model(2, prior), "adversarial": model(3, prior)}
    cases = []
    for ours, options, method, parameters, weights in CASES:
        with tempfile.TemporaryDirectory() as folder:
            folder = Path(folder)
            for name, tensors in models.items():
                save_file(tensors, folder / f"{name}.safetensors")
            out = merged(folder, method, parameters, weights)
        cases.append({"merger": ours, "options": options, "weights": weights, "out": numbers(out)})
    golden = {"models": {name: numbers(tensors) for name, tensors in models.items()}, "cases": cases}
    Path(__file__).with_name("mergekit.json").write_text(json.dumps(golden) + "\n")


main()
