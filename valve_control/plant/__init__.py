"""Simulates the valve: models (2) and (3), friction, flow force, drift, amplifier and LVDT."""
