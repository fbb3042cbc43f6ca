# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Header and source in C99 of a law or a plant."""

import math
from typing import Any, NamedTuple

from valve_control import __version__
from valve_control.control.laws.signals import Start
from valve_control.control.supervision.command_course import Motion
from valve_control.export import kinds, settable
from valve_control.export.emission import wrapped
from valve_control.export.kinds import BOOLEAN, INTEGER, REAL, Kind, comment, identifier
from valve_control.export.settable import Settable, Setter
from valve_control.export.subset import Program, SubsetError
from valve_control.export.unit import Unit, begun, leaves, places

LAW_TYPES = 4  # records of a law that the header shows
FLAGS = "-std=c99 -O2 -ffp-contract=off"  # no fast-math, no fused operations: the bits of Python

# These two are in the header, for the program that includes it, too; the first before the headers of C.
_MACROS = """#if defined(double) || defined(float)
#error "double and float are defined as macros; the numbers here are those of IEEE 754"
#endif"""
_TARGET = """#if CHAR_BIT != 8
#error "the char of this target has not 8 bit"
#endif
#if FLT_RADIX != 2 || REAL_MANT_DIG != DIGITS || REAL_MAX_EXP != EXPONENT || REAL_MIN_EXP != 3 - EXPONENT
#error "the numbers of this target are not those of IEEE 754: export with --float where a double has 32 bits"
#endif"""
_CALCULATION = """#if defined(__FAST_MATH__) || (defined(__FINITE_MATH_ONLY__) && __FINITE_MATH_ONLY__)
#error "compile without -ffast-math, -Ofast and -ffinite-math-only: they take out the checks for NaN"
#endif
#if FLT_EVAL_METHOD != 0
#error "this target calculates with more digits than the numbers have; on x86 use SSE (-msse2 -mfpmath=sse)"
#endif"""


def _target(single: bool) -> str:
    """Checks that ``char`` and the numbers of the target are those of the export."""
    real, digits, exponent = ("FLT", "24", "128") if single else ("DBL", "53", "1024")
    return _TARGET.replace("REAL", real).replace("DIGITS", digits).replace("EXPONENT", exponent)


class Sources(NamedTuple):
    """What is made."""

    header: str
    source: str
    setters: list[Setter]
    others: dict[str, str]  # parameters that need a new export, with the reason
    memory: int  # doubles that a plant needs besides its state
    words: dict[str, int]  # number of each word


def setter_name(unit: Unit, setter: Setter) -> str:
    """Name of the C function."""
    word = identifier(setter.parameter.name.removeprefix(f"{unit.name}.").replace(".", "_"))
    return f"{unit.name}_set_{word}"


def make(unit: Unit, single: bool = False, found: Settable | None = None) -> Sources:
    """Translate ``unit``; ``single``: float in place of double; ``found``: its settable parameters, if known.

    Raises ParameterError.
    """
    own = unit if unit.inner is None else unit.inner
    program = Program(unit.name, own.module, single)
    try:
        public = _public(unit, own)
        names = [program.type_name(kind) for kind in public]
        shown = list(program.types.values())
        at = 0 if unit.inner is None else LAW_TYPES  # the parameters of the whole
        memory = 0
        if unit.is_law:
            parts = [
                _exported(unit, program, public[at], names[at]),
                _law(own, program, public[:LAW_TYPES], names[:LAW_TYPES]),
                _watch(unit, program, public[LAW_TYPES:], names[LAW_TYPES:]),
            ]
        else:
            prototypes, definitions, memory = _plant(unit, program, public, names)
            parts = [(prototypes, definitions)]
    except TypeError as error:
        raise SubsetError(f"{unit.name} cannot be exported to C: {error}") from error
    found = found or settable.find(unit)
    setting = _setters(unit, program, found, names[at])
    prototypes, definitions = (
        [text for part in parts for text in part[i]] + [one[i] for one in setting] for i in range(2)
    )
    words = [f"    {name} = {i}" for i, name in enumerate(program.words.values())]
    enumeration = ["enum {\n" + ",\n".join(words) + "\n};"] if words else []
    private = [*enumeration, *(text for text in program.types.values() if text not in shown)]
    if unit.inner is not None:
        about = "/* What is wrong with a reading, and why there is no voltage. */\n"
        shown = [about + private.pop(0), *shown]
    if memory:
        shown = [
            f"#define {unit.name.upper()}_MEMORY {memory} /* numbers that {unit.name}_init wants */",
            *shown,
        ]
    head = _head(unit, program)
    source = [
        head,
        f'#include "{unit.name}.h"\n\n#include <float.h>\n#include <math.h>',
        _CALCULATION,
        *private,
        *program.constants,
        *program.helpers(),
        *program.functions,
        *definitions,
    ]
    numbered = {word: i for i, word in enumerate(program.words)}
    header = _header(unit, head, single, [*shown, *prototypes])
    return Sources(header, "\n\n".join(source) + "\n", found.setters, found.others, memory, numbered)


def _public(unit: Unit, own: Unit) -> list[Kind]:
    """Records that the header shows: those of a plant or a law, and then those of the watch over the law."""
    public = [Kind("record", getattr(own.module, part)) for part in ("Params", "State")]
    if unit.is_law:
        public += [Kind("record", own.module.Terms), Kind("record", Start)]
    if unit.inner is not None:
        public += [Kind("record", getattr(unit.module, part)) for part in ("Params", "State")]
    return public


def _header(unit: Unit, head: str, single: bool, content: list[str]) -> str:
    """The header file with ``content`` between its guards."""
    guard = f"{unit.name.upper()}_H"
    return "\n\n".join(
        [
            head,
            f"#ifndef {guard}\n#define {guard}",
            _MACROS,
            "#include <float.h>\n#include <limits.h>\n#include <stdbool.h>\n#include <stdint.h>",
            _target(single),
            '#ifdef __cplusplus\nextern "C" {\n#endif',
            *content,
            "#ifdef __cplusplus\n}\n#endif",
            f"#endif /* {guard} */\n",
        ]
    )


def _head(unit: Unit, program: Program) -> str:
    return (
        f"/* {unit.name}: {comment(unit.text)}.\n"
        f" *\n"
        f" * Made by valve_control {__version__} from its Python, in {program.real};\n"
        f" * sample period {unit.period:g} s. Change the parameters and export again; do not edit.\n"
        f" * Compile with {FLAGS}:\n"
        f" * fused or reordered operations would change the last bits.\n"
        f" */"
    )


def _law(unit: Unit, program: Program, public: list[Kind], names: list[str]) -> tuple[list[str], list[str]]:
    """Prototypes and definitions of a law's functions."""
    name, real, module = unit.name, program.real, unit.module
    params, state, _, start = public
    params_t, state_t, terms_t, start_t = names
    initial = program.translate(module.initial, [params, start])
    step = program.translate(module.step, [params, state, REAL, REAL, REAL])
    hold = program.translate(module.hold, [params, state, REAL, REAL, REAL])
    given = f"const {params_t} *p, {state_t} *s, {real} command, {real} measurement"
    stepping = f"{real} {name}_step({given}, {real} offset,\n    {terms_t} *terms)"
    holding = f"void {name}_hold({given}, {real} voltage)"
    results = program.type_name(step.returns)
    prototypes = [
        f"/* Start without a bump at ``start``: the reading, the voltage that is on, the reference. */\n"
        f"void {name}_init(const {params_t} *p, {state_t} *s, const {start_t} *start);",
        "/* One sample: takes in the command [V] and the reading [V], returns the voltage [V] within u_max.\n"
        " * ``offset`` [V] is added before saturation, 0 unless a takeover fades out;\n"
        " * ``terms`` may be 0. */\n"
        f"{stepping};",
        "/* One sample without a reading, in which ``voltage`` [V] was held; ``measurement`` [V]: what the\n"
        " * reading may have been, on a line between those before and after the gap. */\n"
        f"{holding};",
    ]
    definitions = [
        f"void {name}_init(const {params_t} *p, {state_t} *s, const {start_t} *start)\n{{\n"
        f"    *s = {initial.name}(p, start);\n}}",
        f"{stepping}\n{{\n"
        f"    const {results} made = {step.name}(p, s, command, measurement, offset);\n"
        "    *s = made.item1;\n"
        "    if (terms)\n"
        "        *terms = made.item2;\n"
        "    return made.item0;\n}",
        f"{holding}\n{{\n    *s = {hold.name}(p, s, command, measurement, voltage);\n}}",
    ]
    wanted = Kind("tuple", items=(REAL, public[1], public[2]))
    if step.returns != wanted or hold.returns != state or initial.returns != state:
        raise SubsetError(f"the steps of {name} do not return what those of a law do")
    return prototypes, definitions


def _plant(
    unit: Unit, program: Program, public: list[Kind], names: list[str]
) -> tuple[list[str], list[str], int]:
    """Prototypes and definitions of a plant's functions, and the numbers that its arrays hold."""
    name, real, module = unit.name, program.real, unit.module
    params_t, state_t = names[:2]
    read = program.translate(module.read, [*public[:2], REAL])
    step = program.translate(module.step, [*public[:2], REAL])
    lines: list[str] = []
    memory = _begun(program, name, public[1], unit.begin(), "s->", lines, 0)
    given = f"{state_t} *s, {real} *memory" if memory else f"{state_t} *s"
    prototypes, definitions = _exported(unit, program, public[0], params_t)
    reading = f"{real} {name}_read(const {params_t} *p, const {state_t} *s, {real} noise)"
    prototypes += [
        "/* At rest, without voltage"
        + (f"; ``memory`` has {name.upper()}_MEMORY numbers and is written in each step" if memory else "")
        + f". */\nvoid {name}_init({given});",
        f"/* Reading [V] of the sensor at this sample; ``noise`` is a standard normal number. */\n{reading};",
        f"/* One period, over which ``voltage`` [V] is held. */\n"
        f"void {name}_step(const {params_t} *p, {state_t} *s, {real} voltage);",
    ]
    definitions += [
        "\n".join([f"void {name}_init({given})", "{", *lines, "}"]),
        f"{reading}\n{{\n    return {read.name}(p, s, noise);\n}}",
        f"void {name}_step(const {params_t} *p, {state_t} *s, {real} voltage)\n{{\n"
        f"    *s = {step.name}(p, s, voltage);\n}}",
    ]
    return prototypes, definitions, memory


def _begun(
    program: Program, name: str, kind: Kind, value: Any, place: str, lines: list[str], memory: int
) -> int:
    """Add ``lines`` that give the record at ``place`` its ``value``; returns the numbers of arrays used."""
    for field, inner in kinds.fields(kind.record).items():
        item, here = getattr(value, field), f"{place}{identifier(field)}"
        if inner.what == "record":
            memory = _begun(program, name, inner, item, f"{here}.", lines, memory)
        elif inner.what == "array":
            rows, columns = item.shape
            lines += [
                f"    {here}.data = memory + {memory};",
                f"    {here}.rows = {rows};",
                f"    {here}.columns = {columns};",
                f"    for (int i = 0; i < {item.size}; i++)",
                f"        {here}.data[i] = {program.number(0.0)};",
            ]
            if (item != item[0]).any():
                raise SubsetError(f"{name} begins with an array whose rows differ")
            lines += [
                line
                for column, number in enumerate(item[0].tolist())
                if number != 0.0
                for line in (
                    f"    for (int i = 0; i < {rows}; i++)",
                    f"        {here}.data[{columns} * i + {column}] = {program.number(number)};",
                )
            ]
            memory += item.size
        else:
            cast = f"({program.type_name(inner)})" if inner.what == "optional" else ""
            lines += wrapped(f"{here} = {cast}{program.constant(item, inner)};", "    ")
    return memory


class _WatchFunction(NamedTuple):
    """A function of the watch in the header; ``_watch`` formats the texts with its names."""

    name: str
    about: str
    returns: str
    arguments: str
    body: str


_WATCH = (
    _WatchFunction(
        "init", "After switching on: 0 V, until the first reading.", "void", "{state_t} *s", "{begin}"
    ),
    _WatchFunction(
        "command",
        "A command [V] for the next sample, limited; one that is not finite is refused.",
        "void",
        "{both}, {real} value",
        "    {command}(p, s, value, ({real})NAN, {zero});",
    ),
    _WatchFunction(
        "command_at",
        "As before, sent at ``stamp`` [s] of its sender's clock; it came ``since`` [s] after the last\n"
        " * sample.",
        "void",
        "{both}, {real} value, {real} stamp, {real} since",
        "    {command}(p, s, value, stamp, since);",
    ),
    _WatchFunction(
        "command_gone",
        "The upper level has left: its command counts as silent at once.",
        "void",
        "{state_t} *s",
        "    {command_gone}(s);",
    ),
    _WatchFunction(
        "trajectory",
        "A point [V, V/s, V/s^2] of a trajectory, with its times as in command_at; without a stamp (NAN) it\n"
        " * is that of the next sample. It has precedence over commands. False: it is refused.",
        "bool",
        "{both}, {real} position, {real} velocity,\n    {real} acceleration, {real} stamp, {real} since",
        "    const {point_t} point = {{position, velocity, acceleration}};\n"
        "    return {trajectory}(p, s, &point, stamp, since);",
    ),
    _WatchFunction(
        "trajectory_gone",
        "The sender of the trajectory has left: commands are taken again.",
        "void",
        "{state_t} *s",
        "    {trajectory_gone}(s);",
    ),
    _WatchFunction(
        "silence",
        "No sample for ``elapsed`` [s], longer than lvdt.hold_samples: 0 V.",
        "{real}",
        "{both}, {real} elapsed",
        "    return {silence}(p, s, elapsed, false);",
    ),
    _WatchFunction(
        "reset",
        "The law begins again where the spool is, without a bump; doubts about the LVDT are dropped.",
        "void",
        "{both}",
        "    {reset}(p, s);",
    ),
    _WatchFunction(
        "sample",
        "One sample: takes in a reading [V], NAN where there is none, before which ``lost`` samples\n"
        " * were left out; returns the voltage [V]. Bridges up to lvdt.hold_samples, then gives 0 V\n"
        " * until readings can be believed again. s->trust.blocked: why it is off; s->trust.bridged:\n"
        " * samples that are bridged now.",
        "{real}",
        "{both}, {real} reading, int64_t lost",
        "    return {sample}(p, s, reading, lost, {zero}, false);",
    ),
)


def _watch(unit: Unit, program: Program, public: list[Kind], names: list[str]) -> tuple[list[str], list[str]]:
    """Prototypes and definitions of the watch over a law's inputs; none of a law alone."""
    if unit.inner is None:
        return [], []
    (params, state), (params_t, state_t) = public, names
    heads = [program.unique(f"{unit.name}_watch_{one.name}") for one in _WATCH]
    begin: list[str] = []
    _begun(program, unit.name, state, begun(unit.module), "s->", begin, 0)
    point = Kind("record", Motion)
    arguments = {
        "command": [params, state, REAL, REAL, REAL],
        "command_gone": [state],
        "trajectory": [params, state, point, REAL, REAL],
        "trajectory_gone": [state],
        "silence": [params, state, REAL, BOOLEAN],
        "reset": [params, state],
        "sample": [params, state, REAL, INTEGER, REAL, BOOLEAN],
    }
    known = {
        name: program.translate(getattr(unit.module, name), kind).name for name, kind in arguments.items()
    }
    known |= {"real": program.real, "zero": program.number(0.0), "begin": "\n".join(begin)}
    known |= {"state_t": state_t, "both": f"const {params_t} *p, {state_t} *s"}
    known["point_t"] = program.type_name(point)
    prototypes, definitions = [], []
    for name, one in zip(heads, _WATCH, strict=True):
        head = f"{one.returns} {name}({one.arguments})".format(**known)
        prototypes.append(f"/* {one.about} */\n{head};")
        definitions.append(f"{head}\n{{\n{one.body.format(**known)}\n}}")
    return prototypes, definitions


def _exported(unit: Unit, program: Program, kind: Kind, params_t: str) -> tuple[list[str], list[str]]:
    """Declaration and definition of the parameters."""
    lines = _initialiser(program, kind, unit.params, "    ", "")
    return (
        [f"/* The parameters of this export. */\nextern const {params_t} {unit.name}_exported;"],
        ["\n".join([f"const {params_t} {unit.name}_exported = {{", *lines, "};"])],
    )


def _initialiser(program: Program, kind: Kind, value: Any, indent: str, path: str) -> list[str]:
    """Lines of a designated initialiser."""
    lines = []
    for name, inner in kinds.fields(kind.record).items():
        item = getattr(value, name)
        place = f"{indent}.{identifier(name)} = "
        if inner.what == "record":
            lines += [
                f"{place}{{",
                *_initialiser(program, inner, item, indent + "    ", f"{path}{name}."),
                f"{indent}}},",
            ]
        else:
            if inner is REAL and not math.isfinite(item):
                raise SubsetError(f"the parameter {path}{name} of the law is {item}, which C cannot be given")
            lines.append(f"{place}{program.constant(item, inner, exact=True)},")
    return lines


def _setters(unit: Unit, program: Program, found: Settable, params_t: str) -> list[tuple[str, str]]:
    """Prototype and definition of a function for each parameter that can be set."""
    made = []
    by_name: dict[str, list[Setter]] = {}
    for setter in found.setters:
        by_name.setdefault(setter.parameter.name, []).append(setter)
    for name, setters in by_name.items():
        parameter = setters[0].parameter
        unit_text = f" [{parameter.unit}]" if parameter.unit not in ("", "-") else ""
        entries = "" if setters[0].entry is None else "int entry, "
        head = f"bool {setter_name(unit, setters[0])}({params_t} *p, {entries}{program.real} value)"
        about = (
            f"/* {name}{unit_text}: {comment(parameter.text)}.\n"
            f" * {parameter.low:g} to {parameter.high:g}; false, and nothing is changed, outside. */"
        )
        low, high = program.number(parameter.low), program.number(parameter.high)
        lines = [f"    if (!(value >= {low} && value <= {high}))", "        return false;"]
        if setters[0].entry is None:
            lines += [f"    p->{setters[0].path} = value;", "    return true;"]
        else:
            lines.append("    switch (entry) {")
            for setter in setters:
                lines += [
                    f"    case {setter.entry}:",
                    f"        p->{setter.path} = value;",
                    "        return true;",
                ]
            lines += ["    default:", "        return false;", "    }"]
        made.append((f"{about}\n{head};", "\n".join([head, "{", *lines, "}"])))
    return made


def state_numbers(unit: Unit) -> list[str]:
    """Expression in C of each number of ``state``, without arrays and indices."""
    if unit.inner is not None:
        return places(Kind("record", unit.module.State), "state")
    return [f"state.{path}" for path, _ in leaves(unit.begin())]
