"""Analyses, compares and replays recorded runs: the signals and parameters of valves in a bag."""
