"""Controls a proportional directional control valve locally, after Bu and Yao."""

__version__ = "0.1.0"
