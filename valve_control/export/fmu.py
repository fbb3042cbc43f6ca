# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""A law or a plant as an FMU for co-simulation, FMI 2.0 or 3.0, compiled from its C, with the sources inside.

A communication step of any length computes the samples that begin within it, which may be none. A law takes
in command and reading at the beginning of the step, and its voltage is that of the last sample. Its state
starts at the first step, from the first reading.
"""

import hashlib
import io
import platform
import string
import sys
import tempfile
import zipfile
from collections.abc import Iterator, Mapping
from importlib import resources
from pathlib import Path
from typing import Any, NamedTuple, get_type_hints
from xml.etree import ElementTree

from valve_control import __version__
from valve_control.export import compiler, kinds, sources
from valve_control.export.settable import Settable
from valve_control.export.sources import Sources
from valve_control.export.unit import Unit, leaves
from valve_control.parameter import ParameterError

UNITS = (
    "V",
    "V²",
    "V/s³",
    "V/s",
    "V/s²",
    "V·s",
    "s",
    "1/s",
    "1/s²",
    "V/V",
    "V²/s²",
    "-",
)  # beside those of parameters
LINEAR = ("V position of the spool", "V/s velocity", "V/s² inner state", "V/s³ inner state")
PLACES = {2: "binaries/linux64", 3: "binaries/x86_64-linux"}
MOMENT = (1980, 1, 1, 0, 0, 0)  # of all files in it, so that equal exports are equal files


class Variable(NamedTuple):
    """A number that goes in or out."""

    name: str
    causality: str  # input, output, local or parameter
    text: str
    unit: str
    get: str  # expression in C
    set: str = ""  # statement in C that returns whether it could be set
    start: float | None = None
    low: float | None = None
    high: float | None = None


def make(unit: Unit, version: int, found: Settable | None = None) -> bytes:
    """The FMU file of ``unit`` for FMI ``version``; ``found`` as of ``sources.make``.

    Raises ParameterError.
    """
    if sys.platform != "linux" or platform.machine() != "x86_64":
        raise ParameterError(
            "an FMU is made for Linux on x86-64, and this is another machine; export the C instead"
        )
    compiler.find()
    made = sources.make(unit, found=found)
    variables = _variables(unit, made)
    wrapper = {
        file: resources.files(__package__).joinpath(file).read_text(encoding="utf-8")
        for file in ("fmi.h", f"fmi{version}.c")
    }
    content = "".join([made.header, made.source, *wrapper.values(), repr(variables)])
    token = hashlib.sha256(content.encode()).hexdigest()[:32]
    files = {
        f"{unit.name}.c": made.source,
        f"{unit.name}.h": made.header,
        "model.h": _model(unit, made, variables, token),
        **wrapper,
    }
    compiled = [f"{unit.name}.c", f"fmi{version}.c"]
    with tempfile.TemporaryDirectory(prefix="valve_control-export-") as name:
        folder = Path(name)
        for file, text in files.items():
            (folder / file).write_text(text, encoding="utf-8")
        library = folder / f"{unit.name}.so"
        options = ["-fPIC", "-shared", "-Wl,-Bsymbolic", f"-I{folder}"]
        compiler.build([folder / file for file in compiled], library, options)
        binary = library.read_bytes()
    describe = _fmi2 if version == 2 else _fmi3
    entries: dict[str, str | bytes] = {
        "modelDescription.xml": _xml(describe(unit, variables, token, compiled)),
        **{f"sources/{file}": text for file, text in files.items()},
        f"{PLACES[version]}/{unit.name}.so": binary,
    }
    if version == 3:
        entries["sources/buildDescription.xml"] = _xml(_build_description(unit, compiled))
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        for file, data in entries.items():
            information = zipfile.ZipInfo(file, MOMENT)
            information.compress_type = zipfile.ZIP_DEFLATED
            information.external_attr = (0o755 if file.endswith(".so") else 0o644) << 16
            archive.writestr(information, data)
    return stream.getvalue()


def _variables(unit: Unit, made: Sources) -> list[Variable]:
    """All of them; value references count them from 1."""
    ports, fields, texts = (_law_ports if unit.is_law else _plant_ports)(unit)
    return [
        *ports,
        *(_local(name, code, texts.get(name, "")) for name, code in fields),
        *_parameters(unit, made),
    ]


def _law_ports(unit: Unit) -> tuple[list[Variable], list[tuple[str, str]], Mapping[str, str]]:
    """Inputs and outputs of a law; its terms with the C that reads them; descriptions of the terms."""
    ports = [
        Variable("command", "input", "spool position wanted", "V", "m->in[0]", "m->in[0] = value", 0.0),
        Variable("measurement", "input", "LVDT reading", "V", "m->in[1]", "m->in[1] = value", 0.0),
        Variable("voltage", "output", "solenoid voltage", "V", "m->voltage"),
    ]
    names = unit.module.Terms._fields
    fields = [(name, f"m->terms.{kinds.identifier(name)}") for name in names]
    return ports, fields, kinds.field_texts(unit.module.Terms)


def _plant_ports(unit: Unit) -> tuple[list[Variable], list[tuple[str, str]], Mapping[str, str]]:
    """Inputs and outputs of a plant; its state with the C that reads it; descriptions of the states."""
    noise = "standard normal number of the LVDT"
    read = f"{unit.name}_read(&m->p, &m->s, m->in[1])"
    ports = [
        Variable("voltage", "input", "solenoid voltage", "V", "m->in[0]", "m->in[0] = value", 0.0),
        Variable("noise", "input", noise, "", "m->in[1]", "m->in[1] = value", 0.0),
        Variable("measurement", "output", "LVDT reading", "V", read),
    ]
    fields = [(f"state.{path}", f"m->s.{path}") for path, _ in leaves(unit.begin())]
    texts = {f"state.{path}": text for path, text in _texts(unit.module.State)}
    for path in texts:  # of the linear states, whose record is also a row of the matrix
        head, _, last = path.rpartition(".x.x")
        if head.endswith(("state", "valve")):
            texts[path] = LINEAR[int(last)]
    return ports, fields, texts


def _local(name: str, code: str, text: str) -> Variable:
    """A term or a state that the C expression ``code`` reads; ``text`` begins with its unit."""
    first = text.split(" ", 1)[0]
    if first not in UNITS:
        return Variable(name, "local", text, "", code)
    return Variable(name, "local", text[len(first) :].strip(), first.strip("-"), code)


def _parameters(unit: Unit, made: Sources) -> Iterator[Variable]:
    """The parameters that can be set, each with its value in this export."""
    now = dict(leaves(unit.params))
    for setter in made.setters:
        p = setter.parameter
        entry = "" if setter.entry is None else f"{setter.entry}, "
        yield Variable(
            name=p.name if setter.entry is None else f"{p.name}[{setter.entry + 1}]",
            causality="parameter",
            text=p.text,
            unit="" if p.unit == "-" else p.unit,
            get=f"m->p.{setter.path}",
            set=f"{sources.setter_name(unit, setter)}(&m->p, {entry}value)",
            start=now[setter.path],
            low=p.low,
            high=p.high,
        )


def _texts(record: Any) -> Iterator[tuple[str, str]]:
    """Comments beside the fields of a record and of those within it, by path; a record of numbers has one."""
    hints = get_type_hints(record)
    for name, text in kinds.field_texts(record).items():
        inner = dict(_texts(hints[name])) if hasattr(hints[name], "_fields") else {}
        yield from ((f"{name}.{path}", below or text) for path, below in inner.items())
        yield name, text


def _attributes(reference: int, v: Variable) -> dict[str, Any]:
    """Attributes that ``v`` has in either version."""
    parameter, given = v.causality == "parameter", v.causality == "input"
    return {
        "name": v.name,
        "valueReference": reference,
        "description": v.text,
        "causality": v.causality,
        "variability": "tunable" if parameter else "continuous" if given else "discrete",
        "initial": "exact" if parameter else None if given else "calculated",
    }


def _value(v: Variable) -> dict[str, Any]:
    """Attributes of the number itself."""
    start = None if v.start is None else repr(v.start)
    return {"unit": v.unit, "min": v.low, "max": v.high, "start": start}


_MODEL = string.Template("""/* Variables and sampled step of ${name} for the wrapper of FMI. */
#include <math.h>
#include <stdbool.h>
#include <string.h>

#include "${name}.h"

#define MODEL_TOKEN "$token"
#define MODEL_PERIOD $period /* $seconds s */

typedef struct {
    ${name}_params_t p;
    ${name}_state_t s;
    double in[2];
    double time; /* s */
    double ahead; /* periods until the next sample */
$fields
} model_t;

/* Parameters of the export, inputs zero, at rest. */
static void model_reset(model_t *m)
{
    memset(m, 0, sizeof *m);
    m->p = ${name}_exported;$begin
}

static bool model_get(const model_t *m, unsigned reference, double *value)
{
    switch (reference) {
    case 0:
        *value = m->time;
        return true;
$gets
    default:
        return false;
    }
}

static bool model_set(model_t *m, unsigned reference, double value)
{
    if (!isfinite(value))
        return false;
    switch (reference) {
$sets
    default:
        return false;
    }
}

/* The samples that begin within ``step`` [s]; false if it is not positive, or longer than 1e9 of them. */
static bool model_advance(model_t *m, double step)
{
    double span = step / MODEL_PERIOD;
    if (!(span > 0.0 && span <= 1e9))
        return false;
    double periods = fmax(0.0, ceil(span - m->ahead - 1e-6));
    m->ahead += periods - span;
    if (fabs(m->ahead) <= 1e-6 * fmax(1.0, span))
        m->ahead = 0.0;
    for (double k = 0.0; k < periods; k += 1.0) {
$sample
    }
    m->time += step;
    return true;
}
""")


def _model(unit: Unit, made: Sources, variables: list[Variable], token: str) -> str:
    """model.h: functions for the wrapper of either version."""
    name = unit.name
    gets = [
        f"    case {i}:\n        *value = {v.get};\n        return true;" for i, v in enumerate(variables, 1)
    ]
    sets = []
    for i, v in enumerate(variables, 1):
        if v.causality == "parameter":
            sets.append(f"    case {i}:\n        return {v.set};")
        elif v.set:
            sets.append(f"    case {i}:\n        {v.set};\n        return true;")
    if unit.is_law:
        fields = f"    {name}_terms_t terms;\n    double voltage;\n    bool begun;"
        begin = ""
        sample = f"""        if (!m->begun) {{
            const {name}_signals_start_t start = {{m->in[1], 0.0, m->in[1], 0.0, 0.0}};
            {name}_init(&m->p, &m->s, &start);
            m->begun = true;
        }}
        m->voltage = {name}_step(&m->p, &m->s, m->in[0], m->in[1], 0.0, &m->terms);"""
    else:
        fields = f"    double memory[{name.upper()}_MEMORY];" if made.memory else ""
        begin = f"\n    {name}_init(&m->s{', m->memory' if made.memory else ''});"
        sample = f"        {name}_step(&m->p, &m->s, m->in[0]);"
    return _MODEL.substitute(
        name=name,
        token=token,
        period=unit.period.hex(),
        seconds=repr(unit.period),
        fields=fields,
        begin=begin,
        gets="\n".join(gets),
        sets="\n".join(sets),
        sample=sample,
    )


def _xml(root: ElementTree.Element) -> bytes:
    ElementTree.indent(root)
    data: bytes = ElementTree.tostring(root, encoding="utf-8", xml_declaration=True)
    return data + b"\n"


def _add(parent: ElementTree.Element, tag: str, **attributes: object) -> ElementTree.Element:
    given = {name: str(value) for name, value in attributes.items() if value not in (None, "")}
    return ElementTree.SubElement(parent, tag, given)


def _root(unit: Unit, **attributes: str) -> ElementTree.Element:
    """The description, with the ``attributes`` of its version."""
    attributes |= {
        "description": unit.text,
        "generationTool": f"valve_control {__version__}",
        "variableNamingConvention": "flat",
    }
    return ElementTree.Element("fmiModelDescription", attributes)


def _common(unit: Unit, root: ElementTree.Element, variables: list[Variable], *more: str) -> None:
    """Units and the default experiment."""
    units = sorted({v.unit for v in variables if v.unit} | set(more))
    if units:
        definitions = _add(root, "UnitDefinitions")
        for name in units:
            _add(definitions, "Unit", name=name)
    _add(root, "DefaultExperiment", startTime="0.0", stopTime="1.0", stepSize=repr(unit.period))


def _fmi2(unit: Unit, variables: list[Variable], token: str, compiled: list[str]) -> ElementTree.Element:
    root = _root(unit, fmiVersion="2.0", modelName=unit.name, guid=token)
    kind = _add(
        root, "CoSimulation", modelIdentifier=unit.name, canHandleVariableCommunicationStepSize="true"
    )
    listed = _add(kind, "SourceFiles")
    for file in compiled:
        _add(listed, "File", name=file)
    _common(unit, root, variables)
    parent = _add(root, "ModelVariables")
    for i, v in enumerate(variables, 1):
        variable = _add(parent, "ScalarVariable", **_attributes(i, v))
        _add(variable, "Real", **_value(v))
    structure = _add(root, "ModelStructure")
    outputs = [i for i, v in enumerate(variables, 1) if v.causality == "output"]
    for part in ("Outputs", "InitialUnknowns"):
        group = _add(structure, part)
        for i in outputs:
            _add(group, "Unknown", index=i)
    return root


def _fmi3(unit: Unit, variables: list[Variable], token: str, compiled: list[str]) -> ElementTree.Element:
    root = _root(unit, fmiVersion="3.0", modelName=unit.name, instantiationToken=token)
    _add(
        root,
        "CoSimulation",
        modelIdentifier=unit.name,
        canHandleVariableCommunicationStepSize="true",
        fixedInternalStepSize=repr(unit.period),
    )
    _common(unit, root, variables, "s")
    parent = _add(root, "ModelVariables")
    _add(
        parent,
        "Float64",
        name="time",
        valueReference=0,
        causality="independent",
        variability="continuous",
        unit="s",
    )
    for i, v in enumerate(variables, 1):
        _add(parent, "Float64", **_attributes(i, v), **_value(v))
    structure = _add(root, "ModelStructure")
    for tag in ("Output", "InitialUnknown"):
        for i, v in enumerate(variables, 1):
            if v.causality == "output":
                _add(structure, tag, valueReference=i)
    return root


def _build_description(unit: Unit, compiled: list[str]) -> ElementTree.Element:
    root = ElementTree.Element("fmiBuildDescription", fmiVersion="3.0")
    configuration = _add(
        root, "BuildConfiguration", modelIdentifier=unit.name, description="any C99 compiler"
    )
    group = _add(configuration, "SourceFileSet", language="C99", compilerOptions="-ffp-contract=off")
    for file in compiled:
        _add(group, "SourceFile", name=file)
    _add(configuration, "Library", name="m")
    return root
