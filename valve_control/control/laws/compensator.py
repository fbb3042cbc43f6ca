# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Describes the pole-zero compensator (12), (13) or of any design: open loop, the reading is not fed back."""

from valve_control.control.laws import biquads, compensator_design
from valve_control.control.laws.free import Free
from valve_control.control.laws.law import Law
from valve_control.control.plant import transfer_functions
from valve_control.parameter import Parameter, Table, Values, number, word

PRINTED = {
    "printed_second_order": compensator_design.PRINTED_SECOND_ORDER,
    "printed_fourth_order": compensator_design.PRINTED_FOURTH_ORDER,
}
PARAMETERS: Table = (
    Parameter(
        "compensator.design",
        "printed_fourth_order",
        "",
        "printed_second_order: (12), printed_fourth_order: (13), or designed from compensator.model",
        choices=(*PRINTED, "designed"),
    ),
    Parameter(
        "compensator.model",
        "fourth_order",
        "",
        "valve model that it cancels: (2), (3) or custom",
        choices=("second_order", "fourth_order", "custom"),
    ),
    Parameter("compensator.bandwidth", 25.0, "Hz", "-3 dB bandwidth of a designed compensator", 0.1, 1e4),
    Parameter("compensator.order", 0, "", "poles of the Bessel filter; 0: one more than necessary", 0, 6),
    Parameter("compensator.cancel_zeros", True, "", "whether it also cancels stable zeros; (13) does not"),
    *transfer_functions.custom_parameters("compensator."),
)


def build(values: Values) -> biquads.Params:
    """The compensator's Params from the controller's values. Raises ParameterError."""
    chosen, period = word(values, "compensator.design"), number(values, "sample_period")
    transfer_function = PRINTED.get(chosen) or compensator_design.pole_zero_compensator(
        transfer_functions.chosen(values, "compensator.model", "compensator."),
        number(values, "compensator.bandwidth"),
        bool(values["compensator.cancel_zeros"]),
        int(number(values, "compensator.order")),
    )
    return compensator_design.compensator_params(transfer_function, period, number(values, "u_max"))


LAW = Law(
    name="compensator",
    text="pole-zero compensator, open loop (12), (13)",
    module=biquads,
    parameters=PARAMETERS,
    build=build,
    reshapes=lambda params: False,  # the command is followed as it comes
    steady_command=biquads.steady_command,
    free=(Free("compensator.bandwidth", 5.0, 100.0),),
    variants=({"compensator.design": "designed"},),
    form=tuple(p.name for p in PARAMETERS),
)
