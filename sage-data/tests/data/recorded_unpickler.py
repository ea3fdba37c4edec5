#!/usr/bin/env python3
"""Loads pickle programs with CPython's C unpickler and compares their values with those of another reader.

Standard input holds pairs of a program and a text. Each is preceded by its length (four bytes, little-endian).
No global is ever imported or called: `find_class` returns substitutes that record the values that numpy and Python
would construct. Prints the number of programs that agree. The first difference ends the run with exit code 1.
"""
import _pickle
import io
import struct
import sys

KINDS = {"b": (1,), "i": (1, 2, 4, 8), "u": (1, 2, 4, 8), "f": (2, 4, 8)}
FORMATS = {"i1": "b", "i2": "h", "i4": "i", "i8": "q", "u1": "B", "u2": "H", "u4": "I", "u8": "Q", "f2": "e", "f4": "f", "f8": "d"}


class Dtype:
    """numpy.dtype. Without `copy` it is a shared object, and `__setstate__` does not change it."""

    def __init__(self, name, align=False, copy=False):
        name = name.decode("ascii") if isinstance(name, bytes) else name
        self.big = name[0] == ">"
        self.kind, self.size = name.lstrip("<>=|")[0], int(name.lstrip("<>=|")[1:])
        if self.size not in KINDS[self.kind]:
            raise TypeError(name)
        self.fixed = not copy

    def __setstate__(self, state):
        version, order, subtype, names, fields, size, alignment, flags = state
        if self.fixed:
            return
        order = order.decode("ascii") if isinstance(order, bytes) else order
        if version != 3 or len(order) != 1 or (subtype, names, fields) != (None, None, None):
            raise ValueError(state)
        self.big = order == ">"

    def key(self):
        return (self.kind, self.size, self.big and self.size > 1)

    def __eq__(self, other):
        return isinstance(other, Dtype) and self.key() == other.key()

    def __hash__(self):
        return hash(self.key())

    def text(self):
        return f"{self.kind}{self.size}{'>' if self.big else '<'}".encode()


class Array:
    """numpy.ndarray. It shares its dtype object with the code that created it."""

    __hash__ = None

    def __setstate__(self, state):
        version, shape, dtype, fortran, data = state
        if version != 1 or not isinstance(shape, tuple) or not isinstance(dtype, Dtype):
            raise TypeError(state)
        data = data.encode("latin1") if isinstance(data, str) else data
        if not isinstance(data, bytes):
            raise TypeError("pickle not returning string")
        self.fill(shape, dtype, bool(fortran), data, False)

    def fill(self, shape, dtype, fortran, data, from_buffer):
        count = dtype.size
        for n in shape:
            count *= n
        if count != len(data) or any(n < 0 for n in shape):
            raise ValueError("buffer size does not match array size")
        self.shape, self.dtype, self.fortran, self.data, self.from_buffer = shape, dtype, fortran, data, from_buffer


class Scalar:
    """A numpy scalar. It equals any number of the same value."""

    def __init__(self, dtype, data):
        data = data.encode("latin1") if isinstance(data, str) else data
        if not isinstance(dtype, Dtype) or not isinstance(data, bytes) or len(data) != dtype.size:
            raise TypeError("scalar")
        self.dtype, self.data = dtype.text(), data
        if dtype.kind == "b":
            self.value = data != b"\0"
        else:
            self.value = struct.unpack((">" if dtype.big else "<") + FORMATS[f"{dtype.kind}{dtype.size}"], data)[0]

    def __eq__(self, other):
        return self.value == (other.value if isinstance(other, Scalar) else other)

    def __hash__(self):
        return hash(self.value)


class DefaultDict(dict):
    def __init__(self, factory=None):
        if factory is not None and factory is not INT:
            raise TypeError("factory")
        self.factory = factory


class Name:
    """A type that pickles refer to by name and that is never called."""


INT, NDARRAY = Name(), Name()


class Vector(tuple):
    """metadrive.utils.math.Vector: a tuple with arithmetic."""


def reconstruct(cls, shape, dtype):
    if cls is not NDARRAY or shape != (0,) or dtype not in (b"b", "b"):
        raise TypeError("_reconstruct")
    return Array()


def frombuffer(data, dtype, shape, order):
    if not isinstance(data, (bytes, bytearray)) or not isinstance(dtype, Dtype) or order not in ("C", "F"):
        raise TypeError("_frombuffer")
    array = Array()
    array.fill(shape, dtype, order == "F", data, True)
    return array


def encode(text, encoding):
    return text.encode(encoding)


def make_set(items=()):
    return set(items)


def make_bytes():
    return b""


def dtype(*arguments):
    return Dtype(*arguments)


def scalar(*arguments):
    return Scalar(*arguments)


TABLE = {("numpy", "ndarray"): NDARRAY, ("numpy", "dtype"): dtype, ("_codecs", "encode"): encode, ("collections", "defaultdict"): DefaultDict}
for core in ("core", "_core"):
    TABLE[f"numpy.{core}.multiarray", "_reconstruct"] = reconstruct
    TABLE[f"numpy.{core}.multiarray", "scalar"] = scalar
    TABLE[f"numpy.{core}.numeric", "_frombuffer"] = frombuffer
for module in ("math", "math_utils"):
    TABLE[f"metadrive.utils.{module}", "Vector"] = Vector
BUILTINS = {int: INT, set: make_set, bytes: make_bytes}


class Unpickler(_pickle.Unpickler):
    def find_class(self, module, name):
        if (module, name) in TABLE:
            return TABLE[module, name]
        if module in ("builtins", "__builtin__") and name in ("int", "long", "set", "bytes"):
            # CPython decides in which protocols the names of Python 2 are valid. Nothing is called.
            return BUILTINS[super().find_class(module, name)]
        raise _pickle.UnpicklingError(f"{module}.{name}")


def counted(letter, raw):
    return letter + str(len(raw)).encode() + b":" + bytes(raw)


def text(x):
    """The value as bytes. Equal values of equal types give equal bytes."""
    kind = type(x)
    if x is None:
        return b"N"
    if kind is bool:
        return b"T" if x else b"F"
    if kind is int:
        return b"i" + x.to_bytes((~x if x < 0 else x).bit_length() // 8 + 1, "little", signed=True).hex().encode() + b";"
    if kind is float:
        return b"f" + struct.pack(">d", x).hex().encode()
    if kind is str:
        return counted(b"s", x.encode())
    if kind is bytes:
        return counted(b"b", x)
    if kind is bytearray:
        return counted(b"a", x)
    if kind is list:
        return b"[" + b"".join(map(text, x)) + b"]"
    if kind in (tuple, Vector):
        return b"(" + b"".join(map(text, x)) + b")"
    if kind in (set, frozenset):
        return (b"S{" if kind is set else b"Z{") + b"".join(sorted(map(text, x))) + b"}"
    if kind in (dict, DefaultDict):
        head = b"D" if kind is dict else b"En" if x.factory is None else b"Ei"
        return head + b"{" + b"".join(text(k) + text(v) for k, v in x.items()) + b"}"
    if kind is Dtype:
        return b"Y" + x.text()
    if kind is Scalar:
        return b"C" + x.dtype + counted(b"", x.data)
    if kind is Array:
        flags = (b"F" if x.fortran else b"C") + (b"B" if x.from_buffer else b"R")
        return b"A" + x.dtype.text() + flags + text(x.shape) + counted(b"", x.data)
    raise TypeError(kind)


def main():
    source, agreed = sys.stdin.buffer, 0

    def piece():
        head = source.read(4)
        return source.read(struct.unpack("<I", head)[0]) if head else None

    while (program := piece()) is not None:
        expected = piece()
        try:
            found = text(Unpickler(io.BytesIO(program)).load())
        except Exception as error:  # The other reader returned a value, so any exception here is a difference.
            found = repr(error).encode()
        if found != expected:
            print(f"program {program.hex()}\n  here  {found!r}\n  there {expected!r}")
            sys.exit(1)
        agreed += 1
    print(agreed)


main()
