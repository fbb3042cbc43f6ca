"""Both theorems as experiments on thousands of random valves, and the sample period the print asks for."""
