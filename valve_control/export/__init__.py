"""Hands a tuned law, or the valve, over to a machine: C99 and FMU, made from the steps of this package.

``kinds.py``, ``subset.py``  translate the pure steps, and what they call, from Python to C
``unit.py``      what is handed over: a law or a plant with its parameters
``settable.py``  which parameters can be set in C as they are, and which need a new export
``sources.py``   header and source
``samples.py``   a recorded run with which the C is compared
``folder.py``    the folder with sources, comparison, Makefile and README
``library.py``   the C compiled and loaded, in the form of a law's module
``fmu.py``       the same C as an FMU
"""
