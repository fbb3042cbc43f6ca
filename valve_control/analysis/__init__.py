"""Evaluates runs, simulated or recorded: indices, timing, spectra, limit cycles, figures."""
