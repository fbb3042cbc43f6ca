"""Tests both theorems on thousands of random valves, and the sample period that the printed law needs."""
