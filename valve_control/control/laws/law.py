# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Describes a control law to the rest of the package: name, parameters, equations and abilities."""

import types
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple, get_type_hints

from valve_control.arrays import Floats
from valve_control.control import plugins
from valve_control.control.laws import reshaping
from valve_control.control.laws.free import Free, placed
from valve_control.control.laws.projection import Theta
from valve_control.control.laws.signals import Start
from valve_control.control.plant.transfer_functions import Scale, TransferFunction
from valve_control.parameter import Table, Value, Values, defaults

TERMS = ("reference", "z1", "unsaturated_voltage")  # that each law has
Terms = tuple[float, float, float]  # c0 [V/V], c1 [s] and c2 [s²] of a voltage for a motion


def reshaped_steady_command(params: Any, start: Start) -> float:
    """Command [V] under which the reshaped reference goes on as at ``start``."""
    return reshaping.steady_command(params.reshaping, start.measurement, start.velocity)


class Law(NamedTuple):
    """A control law: where its equations are, its parameters, and what it can do."""

    name: str  # of the parameter `controller`, and before the dot of its own parameters
    text: str  # what it is, in a few words
    module: types.ModuleType  # Params, State, Terms, initial, step and hold, as in laws/__init__.py
    parameters: Table
    build: Callable[[Values], Any]  # Params from the controller's values; raises ParameterError
    # a1 [1/s], a0 [1/s²] and b0 [1/s²] of the model that a set of Params believes in; None: no feedback
    model: Callable[[Any], tuple[float, float, float]] | None = None
    # transition matrix (n×n) and input column (n) of the sampled model that a set of Params believes in,
    # position first, where (1) leaves out what the loop needs; None: (1) with what ``model`` gives will do
    sampled_model: Callable[[Any], tuple[Floats, Floats] | None] = lambda params: None
    # whether a set of Params follows a reshaped reference
    reshapes: Callable[[Any], bool] = lambda params: True
    # command under which the law goes on as it is, from which a takeover lets the real one fade in
    steady_command: Callable[[Any, Start], float] = reshaped_steady_command
    # time [s] by which the spool is behind a ramp of the command by design; see ``reshaping.lead``
    lag: Callable[[Values], float] = reshaping.lag
    form: tuple[str, ...] = ()  # parameters after whose change the state means something else
    dead_time: str = ""  # parameter of the dead time [s] of LVDT and bus that it knows of; "": none
    # Params and State with a linear step
    linear: Callable[[Any, Any], tuple[Any, Any]] = lambda params, state: (params, state)
    free: tuple[Free, ...] = ()  # numbers that a tuner may choose, besides those of the reshaping
    # settings with each of which it is tuned, the best wins
    variants: tuple[Mapping[str, Value], ...] = ({},)
    # the model of a valve as the law takes it at a sample period [s], for its parameters of that name
    of_model: Callable[[TransferFunction, float], TransferFunction] = lambda model, period: model
    # other properties of a valve, as the law's parameters: from the controller's values and the valve's
    of_plant: Callable[[Values, Values], Values] = lambda values, plant: {}
    # gains with which a search begins: from the controller's values and the scale of the valve
    starts: Callable[[Values, Scale], list[Values]] = lambda values, scale: []
    # gains of the loop (c0 + c1·s + c2·s²)/(λ·s) for a law that has these: from the controller's values, the
    # three terms, λ [s] and the cutoff [Hz] of the derivative; raises ParameterError
    inverse: Callable[[Values, Terms, float, float], Values] | None = None
    # its feedforward c0·x + c1·dx/dt + c2·d²x/dt², or a part of c0 alone: from the values, the
    # terms and the part
    feedforward: Callable[[Values, Terms, float], Values] = lambda values, terms, part: {}
    remedy: str = "shorten sample_period or lower the gains"  # of a loop that is unstable
    package: str = plugins.PACKAGE  # that brings it

    @property
    def title(self) -> str:
        """Name and package, for messages."""
        return f"the law '{self.name}' of the package {self.package}"

    @property
    def feedback(self) -> bool:
        """Whether the voltage depends on the reading."""
        return self.model is not None

    @property
    def adapts(self) -> bool:
        """Whether it has estimates, the field ``theta`` of its state."""
        return "theta" in self.module.State._fields

    @property
    def estimates_valve(self) -> bool:
        """Whether the estimates are the four parameters of (4)."""
        return get_type_hints(self.module.State).get("theta") is Theta

    @property
    def term_labels(self) -> tuple[str, ...]:
        """Names of the terms that it computes at each sample."""
        return tuple(self.module.Terms._fields)


def try_out(law: Law, values: Values) -> None:
    """Build ``law``, compute one step and one hold. Raises PluginError, or what ``law`` raises."""
    module = law.module
    given = {**values, **defaults(law.parameters)}
    params = law.build(given)
    plugins.check_results([("build", params, module.Params)])
    state = module.initial(params, Start(0.1, 0.0, 0.1, 0.0, 0.0))
    plugins.check_results([("initial", state, module.State)])
    model = (0.0, 0.0, 0.0) if law.model is None else law.model(params)
    if not hasattr(model, "__len__") or len(model) != 3:
        raise plugins.PluginError(f"its model gives {model!r}; it must give three numbers, a1, a0 and b0")
    voltage, after, terms = module.step(params, state, 0.2, 0.1, 0.0)
    held = module.hold(params, state, 0.2, 0.1, 0.0)
    units = [(f"range of {free.name}", free.unit(given)) for free in law.free]
    chosen = placed([(free, free.from_share(0.5)) for free in law.free], given)
    told = {name: getattr(terms, name) for name in TERMS}
    told |= {f"build for Params.{name}": getattr(params, name, None) for name in ("u_max", "period")}
    told |= {f"initial for State.{name}": one for name, one in state._asdict().items() if type(one) is int}
    plugins.check_results(
        [
            *((name, value, float) for name, value in [("step", voltage), *told.items(), *units]),
            ("step", after, module.State),
            ("hold", held, module.State),
            ("step", terms, module.Terms),
        ]
    )
    needed = {*chosen, *([law.dead_time] if law.dead_time else ())}
    needed |= {f"{law.name}.theta_initial"} if law.adapts else set()
    for name in sorted(needed - given.keys()):
        raise plugins.PluginError(f"there must be a parameter {name}")
