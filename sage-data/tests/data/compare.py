#!/usr/bin/env python3
"""Compares pickles pair by pair, value by value: compare.py A B [A B …]

Keys and their order, types, dtypes, shapes and bits must be equal. At the first difference it prints the
difference and exits with 1. It exits with 3 if numpy is missing.
"""
import pickle
import struct
import sys

try:
    import numpy as np
except ImportError:
    sys.exit(3)


def difference(a, b, path):
    if type(a) is not type(b):
        return f"{path}: {type(a)} became {type(b)}"
    if isinstance(a, dict):
        if list(a) != list(b):
            return f"{path}: keys {list(a)[:5]} became {list(b)[:5]}"
        if getattr(a, "default_factory", None) != getattr(b, "default_factory", None):
            return f"{path}: factory"
        return next((d for k in a if (d := difference(a[k], b[k], f"{path}/{k}"))), None)
    if isinstance(a, (list, tuple)):
        if len(a) != len(b):
            return f"{path}: length {len(a)} became {len(b)}"
        return next((d for k, (x, y) in enumerate(zip(a, b)) if (d := difference(x, y, f"{path}/{k}"))), None)
    if isinstance(a, np.ndarray):
        same = a.dtype == b.dtype and a.shape == b.shape and a.flags.f_contiguous == b.flags.f_contiguous
        return None if same and a.tobytes() == b.tobytes() else f"{path}: array"
    if isinstance(a, np.generic):
        return None if a.dtype == b.dtype and a.tobytes() == b.tobytes() else f"{path}: scalar"
    if isinstance(a, float):
        return None if struct.pack("d", a) == struct.pack("d", b) else f"{path}: {a} became {b}"
    return None if a == b else f"{path}: {a!r} became {b!r}"


for first, second in zip(sys.argv[1::2], sys.argv[2::2]):
    with open(first, "rb") as a, open(second, "rb") as b:
        found = difference(pickle.load(a), pickle.load(b), "")
    if found:
        print(f"{first}: {found}")
        sys.exit(1)
