"""Thin ROS 2 adapters around laws and valve; the only room that imports ROS."""

import os

# Matrices of a few rows need no threads. Those of OpenBLAS wait by spinning, and under SCHED_FIFO on one CPU
# the thread that they wait for would never run. It has to be said before numpy is imported.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
