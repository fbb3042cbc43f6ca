"""Local control of a proportional directional control valve after Bu and Yao."""

__version__ = "0.1.0"
