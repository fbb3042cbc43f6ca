# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Hands a tuned law or the valve over to a machine: C99 and FMU made from this package's steps.

``subset.py``    translates the pure steps, and what they call, from Python to C, with ``kinds.py``,
                 ``terms.py``, ``emission.py``, ``values.py``, ``calls.py``, ``expressions.py``,
                 ``statements.py``
``unit.py``      what is handed over: a law, alone or under the watch, or a plant, with its parameters
``settable.py``  which parameters can be set in C as they are, and which need a new export
``sources.py``   header and source
``samples.py``   a recorded run with which the C is compared
``folder.py``    the folder with sources, comparison, Makefile and README
``fmu.py``       the same C as an FMU
"""
