# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""``python -m research.printed``: factorises the compensators (12) and (13) as the paper prints them."""

import argparse
import math
import sys
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from research import running
from valve_control.cli.common import write_json
from valve_control.control.laws import compensator_design
from valve_control.control.plant.transfer_functions import FOURTH_ORDER, SECOND_ORDER, TransferFunction
from valve_control.design.identification import bode
from valve_control.design.identification.bode import Corners
from valve_control.design.identification.result import hertz, polynomial

# (12) was made from this model, not from (2).
PAPER_SECOND_ORDER = TransferFunction((1455.97,), (1.0, 54.05, 1561.22))


class Agreement(NamedTuple):
    """A printed compensator compared with the model and the poles that it was made from."""

    name: str
    printed: TransferFunction
    model: TransferFunction  # whose poles are its zeros
    target: TransferFunction  # its poles, as we found them
    words: str  # the same in words
    again: TransferFunction  # designed again from model and target, static gain 1 with the model
    numerator_errors: tuple[float, ...]  # relative, printed over designed again, both with leading 1
    denominator_errors: tuple[float, ...]  # likewise
    static_gain: float  # V/V, of what is printed, together with the model
    printed_on_second_order: Corners  # with (2)
    printed_on_fourth_order: Corners  # with (3)
    again_on_fourth_order: Corners


def printed() -> list[Agreement]:
    """The printed compensators (12) and (13), compared with the models and poles that they were made from.

    The poles were found by factoring the print: (12) is exactly 25 Hz with damping 0.7 and 250 rad/s; (13) is
    157 rad/s with damping 0.8, twice, and 250 rad/s, but for its coefficient of s⁴, 753 for 752.4.
    """
    slow = 50.0 * math.pi
    pair = [1.0, 1.4 * slow, slow**2]
    double = np.polymul([1.0, 1.6 * 157.0, 157.0**2], [1.0, 1.6 * 157.0, 157.0**2])
    return [
        _agreement(
            "(12)",
            compensator_design.PRINTED_SECOND_ORDER,
            PAPER_SECOND_ORDER,
            np.polymul(pair, [1.0, 250.0]),
            "25 Hz with damping 0.7, and 250 rad/s",
        ),
        _agreement(
            "(13)",
            compensator_design.PRINTED_FOURTH_ORDER,
            FOURTH_ORDER,
            np.polymul(double, [1.0, 250.0]),
            "157 rad/s with damping 0.8, twice, and 250 rad/s",
        ),
    ]


def _agreement(
    name: str, printed: TransferFunction, model: TransferFunction, poles: npt.NDArray[Any], words: str
) -> Agreement:
    gain = float(poles[-1]) / model.denominator[-1] / model.static_gain
    again = TransferFunction(tuple(gain * c for c in model.denominator), tuple(map(float, poles)))
    first = printed.numerator[0]

    def together(c: TransferFunction, valve: TransferFunction) -> Corners:
        return bode.corners(bode.GRID, bode.response(valve, bode.GRID) * bode.response(c, bode.GRID))

    return Agreement(
        name=name,
        printed=printed,
        model=model,
        target=TransferFunction((float(poles[-1]),), tuple(map(float, poles))),
        words=words,
        again=again,
        numerator_errors=_errors(tuple(c / first for c in printed.numerator), model.denominator),
        denominator_errors=_errors(printed.denominator, again.denominator),
        static_gain=printed.static_gain * model.static_gain,
        printed_on_second_order=together(printed, SECOND_ORDER),
        printed_on_fourth_order=together(printed, FOURTH_ORDER),
        again_on_fourth_order=together(again, FOURTH_ORDER),
    )


def _errors(printed: tuple[float, ...], exact: tuple[float, ...]) -> tuple[float, ...]:
    return tuple(a / b - 1.0 for a, b in zip(printed, exact, strict=True))


def _corners(found: Corners) -> str:
    return f"-3 dB at {hertz(found.minus_3db)}, -90° at {hertz(found.minus_90)}"


def _agreement_text(a: Agreement) -> str:
    def told(errors: tuple[float, ...]) -> str:
        return ", ".join(f"{100.0 * error:.2g} %" if abs(error) > 1e-6 else "0" for error in errors[1:])

    return "\n".join(
        [
            f"{a.name} as printed: ({polynomial(a.printed.numerator)})",
            f"  / ({polynomial(a.printed.denominator)})",
            f"  made from ({polynomial(a.model.numerator)}) / ({polynomial(a.model.denominator)})",
            f"  zeros: that model's poles; print off by {told(a.numerator_errors)}",
            f"  poles: {a.words}; print off by {told(a.denominator_errors)}",
            f"  static gain with that model {a.static_gain:.4f}; for 1 its leading coefficient would be "
            f"{a.again.numerator[0]:.7g} instead of {a.printed.numerator[0]:.7g}",
            f"  on (2) as printed:     {_corners(a.printed_on_second_order)}",
            f"  on (3) as printed:     {_corners(a.printed_on_fourth_order)}",
            f"  on (3) designed again: {_corners(a.again_on_fourth_order)}",
        ]
    )


def main(argv: Sequence[str] | None = None) -> int:
    """Print the factors; returns the exit status."""
    return running.run(running.options("printed", "factorise (12) and (13)"), _run, argv)


def _run(arguments: argparse.Namespace) -> None:
    found = printed()
    if arguments.json != "-":
        print("\n".join(_agreement_text(agreement) for agreement in found))
    rows = [
        {name: value._asdict() if hasattr(value, "_asdict") else value for name, value in a._asdict().items()}
        for a in found
    ]
    write_json(arguments, rows)


if __name__ == "__main__":
    sys.exit(main())
