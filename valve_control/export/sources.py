"""Header and source in C99 of a law or a plant."""

import math
from typing import Any, NamedTuple

from valve_control import __version__
from valve_control.export import kinds, settable
from valve_control.export.kinds import REAL, Kind, comment, identifier
from valve_control.export.settable import Found, Setter
from valve_control.export.subset import Program, SubsetError
from valve_control.export.unit import Unit, leaves
from valve_control.laws.signals import Start

FLAGS = "-std=c99 -O2 -ffp-contract=off"  # no fast-math, no fused operations: the bits of Python


class Sources(NamedTuple):
    """What is made."""

    header: str
    source: str
    setters: list[Setter]
    others: dict[str, str]  # parameters that need a new export, with the reason
    memory: int  # doubles that a plant needs besides its state


def setter_name(unit: Unit, setter: Setter) -> str:
    """Name of the C function."""
    word = identifier(setter.parameter.name.removeprefix(f"{unit.name}.").replace(".", "_"))
    return f"{unit.name}_set_{word}"


def make(unit: Unit, single: bool = False) -> Sources:
    """Translate ``unit``; ``single``: float in place of double. Raises ParameterError."""
    program = Program(unit.name, unit.module, single)
    try:
        params, state = (Kind("record", getattr(unit.module, part)) for part in ("Params", "State"))
        if unit.is_law:
            public = [params, state, Kind("record", unit.module.Terms), Kind("record", Start)]
        else:
            public = [params, state]
        names = [program.type_name(kind) for kind in public]
        shown = list(program.types.values())
        memory = 0
        if unit.is_law:
            prototypes, definitions = _law(unit, program, public, names)
        else:
            prototypes, definitions, memory = _plant(unit, program, public, names)
    except TypeError as error:
        raise SubsetError(f"{unit.name} cannot be exported to C: {error}") from error
    found = settable.find(unit)
    for prototype, definition in _setters(unit, program, found, names[0]):
        prototypes.append(prototype)
        definitions.append(definition)
    guard = f"{unit.name.upper()}_H"
    words = [f"    {name} = {i}" for i, name in enumerate(program.words.values())]
    head = _head(unit, program)
    header = "\n\n".join(
        [
            head,
            f"#ifndef {guard}\n#define {guard}",
            "#include <stdbool.h>\n#include <stdint.h>",
            '#ifdef __cplusplus\nextern "C" {\n#endif',
            *(
                [f"#define {unit.name.upper()}_MEMORY {memory} /* numbers that {unit.name}_init wants */"]
                if memory
                else []
            ),
            *shown,
            *prototypes,
            "#ifdef __cplusplus\n}\n#endif",
            f"#endif /* {guard} */\n",
        ]
    )
    private = list(program.types.values())[len(shown) :]
    source = "\n\n".join(
        [
            head,
            f'#include <math.h>\n\n#include "{unit.name}.h"',
            *(["enum {\n" + ",\n".join(words) + "\n};"] if words else []),
            *private,
            *program.constants,
            *program.helpers(),
            *program.functions,
            *definitions,
        ]
    )
    return Sources(header, source + "\n", found.setters, found.others, memory)


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
        f"/* The parameters of this export. */\nextern const {params_t} {name}_exported;",
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
        _exported(unit, program, public[0], params_t),
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
    params_t, state_t = names
    read = program.translate(module.read, [*public, REAL])
    step = program.translate(module.step, [*public, REAL])
    begin = module.initial(unit.params)
    lines, memory = [], 0
    for field, kind in kinds.fields(module.State).items():
        value = getattr(begin, field)
        place = f"s->{identifier(field)}"
        if kind.what == "array":
            rows, columns = value.shape
            lines += [
                f"    {place}.data = memory + {memory};",
                f"    {place}.rows = {rows};",
                f"    {place}.columns = {columns};",
                f"    for (int i = 0; i < {value.size}; i++)",
                f"        {place}.data[i] = {program.number(0.0)};",
            ]
            memory += value.size
            if value.any():
                raise SubsetError(f"{name} begins with an array that is not zero")
        elif kind.what == "record":
            lines += [f"    {place}.{path} = {program.number(number)};" for path, number in leaves(value)]
        else:
            lines.append(f"    {place} = {program.constant(value, kind)};")
    given = f"{state_t} *s, {real} *memory" if memory else f"{state_t} *s"
    prototypes = [
        f"/* The parameters of this export. */\nextern const {params_t} {name}_exported;",
        "/* At rest, without voltage"
        + (f"; ``memory`` has {name.upper()}_MEMORY numbers and is written in each step" if memory else "")
        + f". */\nvoid {name}_init({given});",
        f"/* Reading [V] of the sensor at this sample; ``noise`` is a standard normal number. */\n"
        f"{real} {name}_read(const {params_t} *p, const {state_t} *s, {real} noise);",
        f"/* One period, over which ``voltage`` [V] is held. */\n"
        f"void {name}_step(const {params_t} *p, {state_t} *s, {real} voltage);",
    ]
    definitions = [
        _exported(unit, program, public[0], params_t),
        "\n".join([f"void {name}_init({given})", "{", *lines, "}"]),
        f"{real} {name}_read(const {params_t} *p, const {state_t} *s, {real} noise)\n{{\n"
        f"    return {read.name}(p, s, noise);\n}}",
        f"void {name}_step(const {params_t} *p, {state_t} *s, {real} voltage)\n{{\n"
        f"    *s = {step.name}(p, s, voltage);\n}}",
    ]
    return prototypes, definitions, memory


def _exported(unit: Unit, program: Program, kind: Kind, params_t: str) -> str:
    lines = _initialiser(program, kind, unit.params, "    ", "")
    return "\n".join([f"const {params_t} {unit.name}_exported = {{", *lines, "};"])


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


def _setters(unit: Unit, program: Program, found: Found, params_t: str) -> list[tuple[str, str]]:
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
    """Way in C to each number of the state, without arrays and indices."""
    if not unit.is_law:
        return [path for path, _ in leaves(unit.module.initial(unit.params))]
    begin = unit.module.initial(unit.params, Start(0.0, 0.0, 0.0, 0.0, 0.0))
    return [path for path, _ in leaves(begin)]
