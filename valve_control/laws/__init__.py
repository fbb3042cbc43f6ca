"""Control laws as pure scalar steps: no ROS, no I/O, no clock, no random numbers.

Every law module has the same shape:

``Params``    gains and constants of one configuration, already discretised;
``State``     what the law remembers from sample to sample;
``Terms``     what it computed at this sample, for telemetry and plots;
``initial(params, start)``  the state that starts without a bump at ``start``;
``step(params, state, command, measurement, offset)``  one sample:
              returns ``(voltage, state, terms)``;
``hold(params, state, command, measurement, voltage)``  one sample at which no reading came.

``offset`` [V] is added to the law's output before saturation; it is 0.0 except while one law takes
over from another. Equation numbers are those of the paper, with the corrections listed in the README.
"""
