"""Lists transfer functions of the Parker D3FXE01HCNBJ0011 from voltage to spool position."""

from typing import NamedTuple

from valve_control.parameter import Parameter, ParameterError, Table, Values, numbers, word


class TransferFunction(NamedTuple):
    """Polynomials in s, highest power first."""

    numerator: tuple[float, ...]
    denominator: tuple[float, ...]

    @property
    def static_gain(self) -> float:
        """Gain at s = 0."""
        return self.numerator[-1] / self.denominator[-1]


SECOND_ORDER = TransferFunction((1502.057,), (1.0, 58.771, 1657.206))  # (2)
FOURTH_ORDER = TransferFunction(
    (1206.0, 229256.0, 46882988.0), (1.0, 163.0, 47859.0, 1969807.0, 56553725.0)
)  # (3)
MODELS = {"second_order": SECOND_ORDER, "fourth_order": FOURTH_ORDER}


def custom_parameters(prefix: str) -> Table:
    """Rows of the parameter table for a model that the user gives; their names begin with ``prefix``."""
    return (
        Parameter(
            f"{prefix}numerator",
            [1502.057],
            "",
            "custom model, numerator in s, highest power first",
            -1e12,
            1e12,
        ),
        Parameter(
            f"{prefix}denominator",
            [1.0, 58.771, 1657.206],
            "",
            "custom model, denominator in s, highest power first",
            -1e12,
            1e12,
        ),
    )


def chosen(values: Values, choice: str, prefix: str) -> TransferFunction:
    """Model that parameter ``choice`` names; a custom one comes from ``prefix``. Raises ParameterError."""
    name = word(values, choice)
    if name in MODELS:
        return MODELS[name]
    model = TransferFunction(
        tuple(numbers(values, f"{prefix}numerator")), tuple(numbers(values, f"{prefix}denominator"))
    )
    if not any(model.denominator) or not model.denominator or model.denominator[-1] == 0.0:
        raise ParameterError(
            f"{prefix}denominator is {list(model.denominator)}; its last entry must not be 0"
        )
    if not model.numerator or model.numerator[-1] == 0.0:
        raise ParameterError(f"{prefix}numerator is {list(model.numerator)}; its last entry must not be 0")
    if model.static_gain < 0.0:
        raise ParameterError(
            f"{prefix}numerator is {list(model.numerator)}, so that the static gain is "
            f"{model.static_gain:.3g} V/V; it must be positive, or the spool moves against the voltage"
        )
    return model
