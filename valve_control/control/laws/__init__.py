# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Computes the control laws, one file each, as pure steps on numbers: no ROS, no files, no clock.

Every law module has the same shape:

``Params``    gains and constants of one configuration, already discretised; all numbers of Params and State
              are floats, flags too (1.0: true), since batches keep them in SIMD rows of doubles;
``State``     what the law remembers from sample to sample;
``Terms``     what it computed at this sample, for telemetry and plots;
``initial(params, start)``  the state that starts without a bump at ``start``;
``step(params, state, command, measurement, offset)``  one sample:
              returns ``(voltage, state, terms)``;
``hold(params, state, command, measurement, voltage)``  one sample at which no reading came.

``offset`` [V] is added to the law's output before saturation; it is 0.0 except while one law takes
over from another. Equation numbers are those of the paper, with the corrections of docs/reference/errata.md.
"""
