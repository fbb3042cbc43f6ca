"""Hydraulic axes under five valves: random axes, a published case of Delta, Hopsan's Position Servo."""
