# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Parameters as rcl's own parser reads them, without a node."""

import ctypes

import rclpy  # noqa: F401 (which loads the parser)

from valve_control.control.parameters.arguments import matches

KINDS = ("bool", "int64", "double")


class Allocator(ctypes.Structure):
    _fields_ = [(name, ctypes.c_void_p) for name in ("allocate", "free", "reallocate", "zero", "state")]


def array(kind):
    class Array(ctypes.Structure):
        _fields_ = [("values", ctypes.POINTER(kind)), ("size", ctypes.c_size_t)]

    return ctypes.POINTER(Array)


class Words(ctypes.Structure):
    _fields_ = [("size", ctypes.c_size_t), ("values", ctypes.POINTER(ctypes.c_char_p))]


class Variant(ctypes.Structure):
    _fields_ = [
        ("bool", ctypes.POINTER(ctypes.c_bool)),
        ("int64", ctypes.POINTER(ctypes.c_int64)),
        ("double", ctypes.POINTER(ctypes.c_double)),
        ("word", ctypes.c_char_p),
        ("bytes", ctypes.c_void_p),
        ("bools", array(ctypes.c_bool)),
        ("int64s", array(ctypes.c_int64)),
        ("doubles", array(ctypes.c_double)),
        ("words", ctypes.POINTER(Words)),
    ]


class Section(ctypes.Structure):
    _fields_ = [
        ("names", ctypes.POINTER(ctypes.c_char_p)),
        ("values", ctypes.POINTER(Variant)),
        ("number", ctypes.c_size_t),
        ("capacity", ctypes.c_size_t),
    ]


class Sections(ctypes.Structure):
    _fields_ = [
        ("patterns", ctypes.POINTER(ctypes.c_char_p)),
        ("sections", ctypes.POINTER(Section)),
        ("number", ctypes.c_size_t),
        ("capacity", ctypes.c_size_t),
        ("allocator", Allocator),
    ]


def parser():
    library = ctypes.CDLL("librcl_yaml_param_parser.so")
    library.rcl_yaml_node_struct_init.restype = ctypes.POINTER(Sections)
    library.rcl_yaml_node_struct_init.argtypes = [Allocator]
    library.rcl_parse_yaml_file.argtypes = [ctypes.c_char_p, ctypes.POINTER(Sections)]
    library.rcl_parse_yaml_value.argtypes = [ctypes.c_char_p] * 3 + [ctypes.POINTER(Sections)]
    library.rcl_parse_yaml_value.restype = library.rcl_parse_yaml_file.restype = ctypes.c_bool
    library.rcl_yaml_node_struct_fini.argtypes = [ctypes.POINTER(Sections)]
    return library


def read(node, *sources):
    """Values that a node of this full name has; ``sources``, in turn: a file, or a ``name:=text``."""
    library = parser()
    default = ctypes.CDLL("librcutils.so").rcutils_get_default_allocator
    default.restype, default.argtypes = Allocator, []
    found = library.rcl_yaml_node_struct_init(default())
    for source in map(str, sources):
        name, given, text = source.partition(":=")
        if given:
            words = (word.encode() for word in ("/**", name, text))
            assert library.rcl_parse_yaml_value(*words, found), source
        else:
            assert library.rcl_parse_yaml_file(source.encode(), found), source
    values = {}
    for i in range(found.contents.number):
        section = found.contents.sections[i]
        if matches(found.contents.patterns[i].decode(), node):
            for j in range(section.number):
                values[section.names[j].decode()] = plain(section.values[j])
    library.rcl_yaml_node_struct_fini(found)
    return values


def plain(value):
    for kind in KINDS:
        if pointer := getattr(value, kind):
            return pointer.contents.value
    for kind in (*(f"{name}s" for name in KINDS), "words"):
        if pointer := getattr(value, kind):
            found = list(pointer.contents.values[: pointer.contents.size])
            return [word.decode() for word in found] if kind == "words" else found
    return None if value.word is None else value.word.decode()
