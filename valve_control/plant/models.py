"""Transfer functions of the Parker D3FXE01HCNBJ0011 from voltage to spool position."""

from typing import NamedTuple


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
